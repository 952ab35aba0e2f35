"""Continuous-time symbolic dynamics `dx/dt = F(x, u; p)` and the changes that physical effects make to it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from simgap.errors import UserError
from simgap.late import sympy as sp

_POINTS = 3


def no_number(e: sp.Expr) -> bool:
    """True if something in it is what no rate of change may hold: infinite, undefined or imaginary."""
    return bool(e.has(sp.zoo, sp.nan, sp.oo, -sp.oo, sp.I))


@cache
def kinds(names: str) -> tuple[Any, ...]:
    """SymPy's classes of these names, for `isinstance` and `has`."""
    return tuple(getattr(sp, name) for name in names.split())


def symbol(name: str) -> sp.Symbol:
    """The real symbol of a state, input or parameter; one name is one symbol everywhere."""
    return sp.Symbol(name, real=True)


@dataclass(frozen=True)
class Variable:
    """A state or an input with its unit."""

    name: str
    unit: str

    @property
    def symbol(self) -> sp.Symbol:
        """The variable inside expressions."""
        return symbol(self.name)


@dataclass(frozen=True)
class Parameter:
    """A number of the plant that expressions name."""

    value: float
    unit: str = "1"
    description: str = ""


@dataclass(frozen=True)
class Coordinate:
    """A generalised coordinate (a joint) on which a force may act; position and velocity are state names."""

    name: str
    position: str
    velocity: str
    force_unit: str = "N*m"


@dataclass(frozen=True)
class NamedParameter:
    """A physical property that may be off by a factor.

    `scaling` maps each parameter of the model that changes to its new value, an expression in that model's
    parameters and the symbol `ratio` (true / declared; 1 = as declared).
    """

    name: str
    value: float
    unit: str
    scaling: Mapping[str, sp.Expr]


@dataclass(frozen=True)
class PlanarWheels:
    """Names that make a planar wheeled robot of a model: three states and two inputs."""

    x: str
    y: str
    heading: str
    linear: str
    angular: str
    track: float


def _require(kind: str, name: str, known: Collection[str]) -> None:
    if name not in known:
        raise UserError(f"the plant has no {kind} '{name}'", remedy=f"Known: {list(known)}")


@dataclass(frozen=True)
class SymbolicModel:
    """Continuous dynamics `xdot = F(x, u; p)`, with the hooks that effects act on.

    `force_map[j]` is the column d xdot / d Q_j of the generalised force Q_j on coordinate j (a column of M(q)^-1
    in the velocity rows), so that a force term F changes xdot by `force_map[j] * F`. `outputs` maps a state to
    what its sensor reads; a state that is not listed is read as it is. `delays` maps an input to a pure delay (s).
    `conditions` are inputs that are known parameters, on which no effect of a command acts.
    All changes return a new model.
    """

    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    parameters: Mapping[str, Parameter]
    xdot: tuple[sp.Expr, ...]
    coordinates: tuple[Coordinate, ...] = ()
    force_map: Mapping[str, tuple[sp.Expr, ...]] = field(default_factory=dict)
    named_parameters: Mapping[str, NamedParameter] = field(default_factory=dict)
    gravity: tuple[str, str, str] | None = None
    wheels: PlanarWheels | None = None
    outputs: Mapping[str, sp.Expr] = field(default_factory=dict)
    delays: Mapping[str, sp.Expr] = field(default_factory=dict)
    conditions: tuple[str, ...] = ()

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(v.name for v in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(v.name for v in self.inputs)

    @cached_property
    def units(self) -> Mapping[str, str]:
        """State or input -> its unit."""
        return {v.name: v.unit for v in (*self.states, *self.inputs)}

    @cached_property
    def driven(self) -> Mapping[str, str]:
        """Input -> the coordinate on which it is a force, one to one.

        That is where d xdot / d u is the column of the coordinate's force, here at a few random points.
        """
        numbers, found = self.values(), dict[str, str]()
        columns = (self.xdot, *self.force_map.values())
        every = set().union(*(sp.sympify(e).free_symbols for column in columns for e in column))
        free = sorted(every - set(numbers), key=str)  # states, inputs, and parameters of effects that are still open
        points = [
            {s: sp.Float(v) for s, v in {**numbers, **dict(zip(free, map(float, at), strict=True))}.items()}
            for at in np.random.default_rng(0).uniform(0.2, 1.0, (_POINTS, len(free)))
        ]
        still = {sp.sign(symbol(c.velocity)): sp.Integer(0) for c in self.coordinates}
        for u in self.input_names:  # friction that grows with an input's force leaves it the force that it is
            pulls = [sp.diff(sp.sympify(e).xreplace(still), symbol(u)) for e in self.xdot]
            for c in self.coordinates:
                off = [p - f for p, f in zip(pulls, self.force_map[c.name], strict=True)]
                if all(abs(sp.N(e.xreplace(at))) < 1e-9 for at in points for e in off):
                    found[u] = c.name
        return found

    @property
    def derived(self) -> bool:
        """True if the equations are written out; those of an arm of several joints hold numeric stand-ins."""
        return not any(sp.sympify(e).has(sp.core.function.AppliedUndef) for e in self.xdot)

    def coordinate(self, name: str) -> Coordinate:
        """The coordinate of that name.

        Raises:
            UserError: if the plant has no such coordinate.
        """
        named = {c.name: c for c in self.coordinates}
        _require("coordinate", name, named)
        return named[name]

    def values(self) -> dict[sp.Symbol, float]:
        """Declared numbers of all parameters, for substitution."""
        return {symbol(name): p.value for name, p in self.parameters.items()}

    def numeric(self, under: Mapping[str, float] | None = None) -> tuple[sp.Expr, ...]:
        """xdot with every parameter replaced by its number: the one `under` which it is asked for, or the declared one.

        Raises:
            UserError: where that is not a finite real number, such as 1/m with m = 0.
        """
        values = self.values() | {symbol(name): value for name, value in (under or {}).items()}
        said = ", ".join(f"{name} = {value:.6g}" for name, value in (under or {}).items()) or "the declared parameters"
        found = tuple(sp.sympify(e).subs(values) for e in self.xdot)
        for state, rate in zip(self.states, found, strict=True):
            if no_number(rate):
                problem = f"the rate of '{state.name}' is not a finite real number with {said}"
                raise UserError(problem, key="plant", remedy="Correct the parameters or the equation.")
        return found

    def with_parameter(self, name: str, parameter: Parameter) -> SymbolicModel:
        """The model with one more (or a changed) parameter."""
        return replace(self, parameters={**self.parameters, name: parameter})

    def with_force(self, coordinate: str, force: sp.Expr) -> SymbolicModel:
        """The model with a generalised force added on a coordinate."""
        column = self.force_map[self.coordinate(coordinate).name]
        return replace(self, xdot=tuple(f + c * force for f, c in zip(self.xdot, column, strict=True)))

    def with_input(self, name: str, applied: sp.Expr) -> SymbolicModel:
        """The model in which the plant feels `applied` (an expression of the command `name`) instead of the command."""
        _require("input", name, self.input_names)
        return self._subs({symbol(name): applied})

    def substitute(self, changes: Mapping[str, sp.Expr]) -> SymbolicModel:
        """The model with parameters replaced by expressions, everywhere and at once."""
        return self._subs({symbol(name): expr for name, expr in changes.items()})

    def with_output(self, state: str, reading: sp.Expr) -> SymbolicModel:
        """The model in which the sensor of `state` reads an expression of the states."""
        _require("state", state, self.state_names)
        return replace(self, outputs={**self.outputs, state: reading})

    def with_state(self, state: Variable, xdot: sp.Expr) -> SymbolicModel:
        """The model with one more state at the end."""
        grown = {name: (*column, sp.Integer(0)) for name, column in self.force_map.items()}
        return replace(self, states=(*self.states, state), xdot=(*self.xdot, xdot), force_map=grown)

    def with_delay(self, name: str, seconds: sp.Expr) -> SymbolicModel:
        """The model whose input acts `seconds` after its command."""
        _require("input", name, self.input_names)
        return replace(self, delays={**self.delays, name: self.delays.get(name, sp.Integer(0)) + seconds})

    def _subs(self, changes: Mapping[sp.Symbol, sp.Expr]) -> SymbolicModel:
        def sub(e: sp.Expr) -> sp.Expr:
            return sp.sympify(e).xreplace(changes)

        return replace(
            self,
            xdot=tuple(sub(e) for e in self.xdot),
            force_map={name: tuple(sub(e) for e in column) for name, column in self.force_map.items()},
        )
