"""The sections `plant` (the nominal model, from a URDF or from equations in the case) and `domain` (tau, X and U)."""

from __future__ import annotations

import itertools
from typing import Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from simgap.arrays import Floats
from simgap.config.base import Interval, Seconds, Section

Integrator = Literal["explicit_euler", "semi_implicit_euler", "rk4", "exact_arc"]


class State(Section):
    """One state of the plant."""

    unit: str
    """Unit of the state, such as rad, rad/s or m."""
    joint: str | None = None
    """URDF plants: the joint whose quantity this state is."""
    quantity: Literal["position", "velocity"] | None = None
    """URDF plants: which quantity of the joint this state is."""
    lag_of: str | None = None
    """The input whose lagged value this state is: an effect that lags (`input_lag`) is then part of the nominal model.
    The state is called <input>_lagged, comes after the plant's own, and has its range in domain.X. Without it a lag is
    left to gamma."""


class Input(Section):
    """One input of the plant."""

    unit: str
    """Unit of the input, such as N*m or m/s."""
    joint: str | None = None
    """URDF plants: the joint on which the input is a force or torque."""


class SymbolicParameter(Section):
    """A number that the equations name."""

    value: float
    """Its declared value."""
    unit: str = "1"
    """Its unit."""
    description: str = ""
    """What it is."""


class SymbolicCoordinate(Section):
    """A degree of freedom of written equations on which friction, springs and the like may act."""

    OPTIONAL = ("force_map", "force_unit")

    model_config = ConfigDict(coerce_numbers_to_str=True)  # a plain number is an expression too

    position: str
    """The state that is its position."""
    velocity: str
    """The state that is its velocity."""
    force_gain: str | None = None
    """d(velocity rate)/d(force): an expression, for one hinge 1/(inertia). Not with `force_map` or `mass_matrix`."""
    force_map: dict[str, str] | None = None
    """For each velocity, d(its rate)/d(force on this coordinate): an expression; 0 for velocities that are not
    named. Use it in place of `force_gain` if the force moves other coordinates too."""
    force_unit: str | None = None
    """Unit of the force on it. If not given: N for a length, N*m for an angle or a position without a unit;
    otherwise the unit with which force times position is an energy."""


class Wheels(Section):
    """States and inputs by which the equations are those of a planar wheeled robot."""

    x: str
    """The state that is the position along x."""
    y: str
    """The state that is the position along y."""
    heading: str
    """The state that is the heading."""
    linear: str
    """The input that is the speed."""
    angular: str
    """The input that is the turning rate."""
    track: float = Field(gt=0)
    """Distance between the wheels, m."""


class SymbolicPlant(Section):
    """Dynamics written as expressions; parsed by a whitelist and never evaluated as code."""

    OPTIONAL = ("mass_matrix",)

    model_config = ConfigDict(coerce_numbers_to_str=True)  # a plain number is an expression too

    parameters: dict[str, SymbolicParameter] = Field(default_factory=dict)
    """Named numbers of the plant."""
    dynamics: dict[str, str]
    """For each state its rate of change: an expression of states, inputs and parameters with + - * / ^, sin, cos, tan,
    atan, tanh, exp, log, sqrt, abs, sign, min, max."""
    coordinates: dict[str, SymbolicCoordinate] = Field(default_factory=dict)
    """Degrees of freedom on which forces may act."""
    mass_matrix: tuple[tuple[str, ...], ...] | None = None
    """The mass matrix M of the equations of motion M(q) dv/dt = ..., rows and columns in the order of `coordinates`,
    expressions of positions and parameters. With it a force on one coordinate moves the others."""
    gravity: tuple[str, str, str] | None = None
    """Names of three parameters that are gravity's components along x, y, z of the world."""
    wheels: Wheels | None = None
    """Roles of states and inputs of a planar wheeled robot."""


class AddedEffect(Section):
    """A physical effect with numbers; `simgap effects` lists the names."""

    name: str
    """Name of the effect."""
    on: str
    """What it acts on: a coordinate, an input, a state, a parameter or the plant."""
    parameters: dict[str, float]
    """Its numbers by symbol, in the units that `simgap effects CASE` lists."""


class PlantSection(Section):
    """The nominal model: either `urdf` or `symbolic`, with its states and inputs in order."""

    urdf: str | None = None
    """Model file, relative to the case file; loaded by Drake."""
    symbolic: SymbolicPlant | None = None
    """Equations instead of a model file."""
    states: dict[str, State] = Field(min_length=1)
    """The states, in order."""
    inputs: dict[str, Input] = Field(default_factory=dict)
    """The inputs, in order; none for a free plant."""
    integrator: Integrator = "explicit_euler"
    """How the dynamics are discretised over tau."""
    gravity: float = 9.81
    """Acceleration along -z for a URDF plant, m/s^2."""
    effects: tuple[AddedEffect, ...] = ()
    """Effects added to the nominal model."""

    @model_validator(mode="after")
    def _one_source(self) -> PlantSection:
        own = {n: s for n, s in self.states.items() if s.lag_of is None}
        if (self.urdf is None) == (self.symbolic is None):
            raise ValueError("a plant has either urdf or symbolic: give one of them")
        if self.urdf is not None:
            bare = [n for n, s in own.items() if s.joint is None or s.quantity is None]
            bare += [n for n, i in self.inputs.items() if i.joint is None]
            if bare:
                raise ValueError(f"{bare} of a URDF plant need a joint (and states a quantity)")
        elif self.symbolic is not None and set(self.symbolic.dynamics) != set(own):
            raise ValueError(f"dynamics are given for {sorted(self.symbolic.dynamics)}, states are {sorted(own)}")
        lags = {f"{s.lag_of}_lagged" for s in self.states.values() if s.lag_of is not None}
        if list(self.states)[len(own) :] != sorted(lags) or len(self.states) != len(own) + len(lags):
            raise ValueError(f"states with lag_of come last, as {sorted(lags)}")
        return self


MOST_VALUES = 2.0**53
"""Most values of one input: beyond it doubles do not count by ones."""


class InputSet(Section):
    """The values that one input may take: `values`, or all of min, min + step, ..., max."""

    min: float | None = None
    """Smallest value."""
    max: float | None = None
    """Largest value."""
    step: float | None = Field(None, gt=0)
    """Distance between neighbours."""
    values: tuple[float, ...] | None = None
    """The values one by one, instead of a range."""

    @model_validator(mode="after")
    def _not_empty(self) -> InputSet:
        if self.values is not None:
            if not (self.min is None and self.max is None and self.step is None):
                raise ValueError("an input set has either values, or min, max and step")
            if len(self.values) == 0:
                raise ValueError("U is empty: list at least one value")
            return self
        if self.min is None or self.max is None or self.step is None:
            raise ValueError("an input set needs values, or min, max and step")
        if self.max < self.min:
            raise ValueError(f"U is empty: max {self.max} is below min {self.min}")
        if not (self.max - self.min) / self.step < MOST_VALUES:
            raise ValueError(
                f"a step of {self.step} from {self.min} to {self.max} gives more values than can be counted"
            )
        return self

    @property
    def count(self) -> int:
        """Number of values."""
        if self.values is not None:
            return len(self.values)
        low, high, step = (float(v) for v in (self.min, self.max, self.step) if v is not None)
        return int(np.floor((high - low) / step + 1e-9)) + 1

    def list(self) -> Floats:
        """The values in ascending order, (n,); decimal steps give the decimals a person would write."""
        if self.values is not None:
            return np.array(sorted(self.values))
        assert self.min is not None
        assert self.step is not None
        return np.round(self.min + self.step * np.arange(self.count), 12)


class DomainSection(Section):
    """Region in which the model is compared with the simulator and the controller works."""

    tau: Seconds = Field(gt=0)
    """Sampling time, in seconds or with a unit ('5 ms')."""
    X: dict[str, Interval]
    """For each state its lower and upper end, in its unit; angles in rad, not degrees."""
    U: dict[str, InputSet] = Field({})
    """For each input the values that it may take."""
    periodic: tuple[str, ...] = ()
    """States that wrap around at the ends of X, such as a heading; X is one turn."""

    @model_validator(mode="after")
    def _periodic_states(self) -> DomainSection:
        unknown = [name for name in self.periodic if name not in self.X]
        if unknown:
            raise ValueError(f"periodic names {unknown}, which are not states of X")
        return self

    def inputs(self, order: list[str]) -> Floats:
        """All of U as rows (M, nu), the last input running fastest."""
        return np.array(list(itertools.product(*(self.U[name].list() for name in order))), dtype=np.float64)
