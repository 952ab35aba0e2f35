"""One compiled model that holds every candidate effect, each switched off until its parameters say otherwise."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, TypeVar

import numpy as np
from numba import float64 as f64
from numba import types, void

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.measurement import ReadingFault, is_fault, possible
from simgap.diagnosis.simulation.dynamics import Dynamics, compile_dynamics
from simgap.effects import EFFECTS, Effect, EffectParameter, StaticInputEffect, effect
from simgap.effects.base import CoordinateEffect, MemoryForceEffect, driven_by
from simgap.effects.commands import InputEffect, MemoryInputEffect
from simgap.effects.drive_train import DriveTrainEffect, Law, with_motor
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.compile import Kernel, cached_kernel_as, compile_kernel
from simgap.model.symbolic import SymbolicModel, kinds, symbol

T = TypeVar("T")
_ROWS = types.Array(types.float64, 2, "C")
_ROWWISE = void(_ROWS, f64[::1], _ROWS)
_TRANSCENDENTAL = "sin cos tan tanh atan exp log"


@dataclass(frozen=True)
class Candidate:
    """An effect on one target, with the places of its parameters in theta."""

    effect: Effect
    on: str
    slots: tuple[int, ...]

    @property
    def key(self) -> tuple[str, str]:
        """Name and target."""
        return self.effect.name, self.on

    def values(self, theta: Sequence[T]) -> dict[str, T]:
        """Its numbers among all parameters, by symbol."""
        return {p.symbol: theta[k] for p, k in zip(self.effect.parameters, self.slots, strict=True)}

    def by_slot(self, values: Mapping[str, float]) -> dict[int, float]:
        """The same numbers, as far as they are given, by their place in theta."""
        own = zip(self.effect.parameters, self.slots, strict=True)
        return {k: values[p.symbol] for p, k in own if p.symbol in values}

    @property
    def free(self) -> tuple[int, ...]:
        """Places of the numbers that a fit changes; starts choose the others."""
        own = zip(self.effect.parameters, self.slots, strict=True)
        return tuple(k for p, k in own if not p.integer)

    @property
    def of_recording(self) -> bool:
        """Whether it is a fault of the recording, and not of the plant."""
        return is_fault(self.effect.name)


_RIGID = 10.0  # rad between two readings: a spring that is quicker is simulated no more, as each turn costs steps


@dataclass(frozen=True)
class Train:
    """A motor behind a coordinate.

    Attributes:
        on: the coordinate; law: the torque between them, over theta.
        position, velocity: places of the link's states; inputs: columns of what drives the motor.
        slots: places in theta of its numbers; numbers: theta -> those of its law.
    """

    on: str
    law: Law
    position: int
    velocity: int
    inputs: tuple[int, ...]
    slots: tuple[int, ...]
    numbers: Callable[[Floats], Sequence[float]]

    def swings(self, theta: Floats) -> bool:
        """Whether what is not read does not forget how it began: a motor on a spring; a link that nothing reads."""
        return self.numbers(theta)[1] > 0.0 or self.read_at_motor(theta)

    def read_at_motor(self, theta: Floats) -> bool:
        """Whether the joint's sensors read the motor, and the link is what has to be inferred."""
        return self.numbers(theta)[7] > 0.0

    def quick(self, theta: Floats) -> float:
        """How fast the motor swings against a link that stands still, 1/s; 0 where there is no motor."""
        inertia, spring, _, _, stops, *_ = self.numbers(theta)
        stiffness = spring + stops
        return math.sqrt(stiffness / inertia) if inertia > 0.0 and stiffness > 0.0 else 0.0

    def rigid(self, theta: Floats, interval: float) -> bool:
        """Whether the spring is so stiff that readings this far apart (s) tell nothing of it."""
        inertia, spring, *_ = self.numbers(theta)
        return spring * interval**2 > _RIGID**2 * inertia


@dataclass(frozen=True, eq=False)
class SuperModel:
    """The plant with all candidates at their null.

    Attributes:
        model: the model as declared.
        candidates: every effect that may be tried, on every target.
        null: theta at which no effect acts.
        dynamics: the compiled plant; its u is what the plant feels.
        static: numba (u rows (n, m), theta, out (n, m)): commands through gain, bias, dead zone and saturation.
        read: numba (x rows (n, nx), theta, out (n, k)): what the measured channels read.
        past: (z, v, theta) -> [dz/dt, ...] of the states of `remembered`, over arrays; None if there are none.
        trains: motors behind coordinates, in the order of their states, which come next after the plant's.
        memory: (theta) -> (2 m,), delays of the inputs, those that the model already declares among them, then their
            lags, s.
    """

    model: SymbolicModel
    candidates: tuple[Candidate, ...]
    null: Floats
    lower: Floats
    upper: Floats
    measured: tuple[str, ...]
    dynamics: Dynamics
    static: Any
    read: Any
    past: Any
    trains: tuple[Train, ...]
    memory: Callable[[Floats], Sequence[float]]

    @property
    def nx(self) -> int:
        """Number of states, those of the effects left out."""
        return len(self.model.states)

    @cached_property
    def begun(self) -> int:
        """Numbers that begin a window: the plant's states, and how far a motor is from where the past tells it."""
        return self.nx + 2 * len(self.trains)

    @cached_property
    def remembered(self) -> tuple[Candidate, ...]:
        """Effects with a state of their own, in the order of these states, which come after the plant's."""
        return tuple(c for c in self.candidates if isinstance(c.effect, MemoryForceEffect))

    def jerks(self, theta: Floats) -> bool:
        """Whether an effect that jerks acts at theta (q,)."""
        return any(c.effect.jerks and theta[c.slots[-1]] != self.null[c.slots[-1]] for c in self.candidates)

    def rubs(self, theta: Floats) -> bool:
        """Whether any coordinate has dry friction at theta (q,): the sign of a speed matters at rest."""
        x, speed = np.zeros(self.begun + len(self.remembered)), self.dynamics.speed
        u = np.ones(len(self.model.input_names))  # friction may grow with the load; a condition may divide the forces
        ways = np.eye(len(speed)), -np.eye(len(speed))
        up, down = ([self.dynamics.derivative(x, u, theta, s)[speed[j]] for j, s in enumerate(way)] for way in ways)
        return bool(np.any(np.abs(np.subtract(up, down)) > 1e-12))

    @cached_property
    def reading_faults(self) -> tuple[tuple[ReadingFault, int, int], ...]:
        """Faults of the readings, with their column among the measured channels and their place in theta."""
        return tuple(
            (c.effect, self.measured.index(c.on), c.slots[0])
            for c in self.candidates
            if isinstance(c.effect, ReadingFault)
        )

    @cached_property
    def input_slots(self) -> tuple[int, ...]:
        """Places in theta of everything that acts between command and plant."""
        return tuple(k for c in self.candidates if isinstance(c.effect, InputEffect) for k in c.slots)

    def find(self, name: str, on: str) -> Candidate:
        """The candidate of that name and target."""
        return next(c for c in self.candidates if c.key == (name, on))


def build_supermodel(
    model: SymbolicModel, measured: tuple[str, ...], effects: Collection[str] = (), second: bool = False,
    last: bool = False,
) -> SuperModel:  # fmt: skip
    """Put every effect of the library (or those named) on every target and compile the result once.

    Effects that others are tried before are in it if they are named, or if `second` asks for them; those
    that are sought last if they are named, or if `last` asks for them.

    Raises:
        UserError: for an unknown effect, or a measured channel that is not a state.
    """
    named = {effect(name).name for name in effects}
    for name in measured:
        if name not in model.state_names:
            raise UserError(f"'{name}' is measured but not a state", remedy=f"States: {list(model.state_names)}.")
    chosen = [
        e for e in EFFECTS.values()
        if e.name in named or (not named and (last or not e.last) and (second or not e.second))
    ]  # fmt: skip
    places = [(e, on) for e in chosen for on in (e.targets(model) if e.name in named else e.sought_on(model))]
    asked = [(e, on) for e, on in _beside_motors(model, places) if e.kind != "state" or on in measured]
    candidates: list[Candidate] = []
    specs: list[EffectParameter] = []
    for e, on in [*asked, *possible(model, measured)]:
        candidates.append(Candidate(e, on, tuple(range(len(specs), len(specs) + len(e.parameters)))))
        specs += list(e.parameters)
    theta = tuple(symbol(f"theta_{k}") for k in range(len(specs)))
    trains = _trains(model, candidates, theta)
    driven = model
    for train in trains:
        driven = with_motor(driven, train.on, train.law)
    plant, costly, gate = _insert(driven, candidates, theta)
    readings = [sp.sympify(plant.outputs.get(n, symbol(n))).subs(model.values()) for n in measured]
    return SuperModel(
        model=model,
        candidates=tuple(candidates),
        null=np.array([p.null for p in specs]),
        lower=np.array([p.lower for p in specs]),
        upper=np.array([p.upper for p in specs]),
        measured=measured,
        dynamics=compile_dynamics(plant, costly, gate, theta),
        static=_rowwise(compile_kernel(*_commands(model, candidates, theta))) if model.inputs else _no_columns,
        read=_rowwise(compile_kernel(readings, ([v.symbol for v in plant.states], theta))),
        past=_past(candidates, theta),
        trains=trains,
        memory=sp.lambdify([theta], _memory(model, candidates, theta), modules="math"),
    )


def _beside_motors(model: SymbolicModel, places: list[tuple[Effect, str]]) -> list[tuple[Effect, str]]:
    """Without what has no place where a motor stands behind its joint: a law of the speed of what an input drives."""
    loose = model
    for on in dict.fromkeys(on for e, on in places if isinstance(e, DriveTrainEffect)):
        loose = with_motor(loose, on, Law(sp.Integer(1)))
    return [(e, on) for e, on in places if isinstance(e, DriveTrainEffect) or on in e.targets(loose)]


def _trains(model: SymbolicModel, candidates: list[Candidate], theta: tuple[sp.Symbol, ...]) -> tuple[Train, ...]:
    """One for each coordinate behind which an effect puts a motor."""
    motors, found = [(c, c.effect) for c in candidates if isinstance(c.effect, DriveTrainEffect)], []
    for on in dict.fromkeys(c.on for c, _ in motors):
        own = [(c, e) for c, e in motors if c.on == on]
        law = reduce(operator.add, (e.law(c.values(theta)) for c, e in own))
        link, place = model.coordinate(on), model.state_names.index
        inputs = tuple(model.input_names.index(u) for u in driven_by(model, on))
        slots = tuple(k for c, _ in own for k in c.slots)
        numbers = sp.lambdify([theta], law.numbers, modules="math")
        found.append(Train(on, law, place(link.position), place(link.velocity), inputs, slots, numbers))
    return tuple(found)


def _insert(
    model: SymbolicModel, candidates: list[Candidate], theta: tuple[sp.Symbol, ...]
) -> tuple[SymbolicModel, list[sp.Expr], sp.Expr]:
    """The plant as a function of what it feels; apart costly terms of xdot, which act where a gate is not 0."""
    plant = model
    for c in candidates:
        if not isinstance(c.effect, CoordinateEffect | InputEffect | DriveTrainEffect):
            plant = c.effect.insert(plant, c.on, c.values(theta))
    costly, gate = [sp.Integer(0) for _ in plant.states], sp.Integer(0)
    for c in candidates:  # forces after the plant's own parameters, on which the columns depend
        if isinstance(c.effect, CoordinateEffect):
            joint = plant.coordinate(c.on)
            force = c.effect.force(symbol(joint.position), symbol(joint.velocity), c.values(theta))
            if force.has(*kinds(_TRANSCENDENTAL)):
                costly = [e + column * force for e, column in zip(costly, plant.force_map[c.on], strict=True)]
                gate += sum(sp.Abs(theta[k] - p.null) for p, k in zip(c.effect.parameters, c.slots, strict=True))
            else:
                plant = plant.with_force(c.on, force)
    return plant, costly, gate


def _commands(
    model: SymbolicModel, candidates: list[Candidate], theta: tuple[sp.Symbol, ...]
) -> tuple[list[sp.Expr], tuple[Sequence[sp.Symbol], ...], list[tuple[sp.Symbol, sp.Expr]]]:
    """What the plant feels as a function of the command: for `compile_kernel`, an effect a step."""
    felt: dict[str, sp.Expr] = {v.name: v.symbol for v in model.inputs}
    steps: list[tuple[sp.Symbol, sp.Expr]] = []
    for c in reversed(candidates):  # from the command to the plant
        if isinstance(c.effect, StaticInputEffect):
            name = sp.Symbol(f"x{len(steps)}", real=True)
            steps.append((name, c.effect.applied(felt[c.on], c.values(theta))))
            felt[c.on] = name
    return list(felt.values()), ([v.symbol for v in model.inputs], theta), steps


def _memory(model: SymbolicModel, candidates: list[Candidate], theta: tuple[sp.Symbol, ...]) -> list[sp.Expr]:
    """Delay of each input, then lag of each input."""
    delay = {n: sp.sympify(model.delays.get(n, 0)).subs(model.values()) for n in model.input_names}
    lag = dict.fromkeys(model.input_names, sp.Integer(0))
    for c in candidates:
        if isinstance(c.effect, MemoryInputEffect):
            delay[c.on] += c.effect.delay(c.values(theta))
            lag[c.on] += c.effect.lag(c.values(theta))
    return [*delay.values(), *lag.values()]


def _past(candidates: list[Candidate], theta: tuple[sp.Symbol, ...]) -> Any:
    """Rates of the effects' own states over (z, v) of each, and theta."""
    own = [(c, c.effect) for c in candidates if isinstance(c.effect, MemoryForceEffect)]
    z, v = ([symbol(f"{kind}_{k}") for k in range(len(own))] for kind in ("z", "v"))
    rates = [e.rate(memory, speed, c.values(theta)) for (c, e), memory, speed in zip(own, z, v, strict=True)]
    return sp.lambdify([z, v, theta], rates, modules="numpy") if own else None


def _rowwise(kernel: Kernel) -> Any:
    @cached_kernel_as(_ROWWISE)
    def rows(x: Any, th: Any, out: Any) -> None:
        for k in range(x.shape[0]):
            values = kernel(x[k], th)
            for i in range(out.shape[1]):
                out[k, i] = values[i]

    return rows


def _no_columns(x: Floats, theta: Floats, out: Floats) -> None:
    """The inputs of a plant that has none."""


_COMPILED: dict[str, SuperModel] = {}


def cached_supermodel(
    model: SymbolicModel, measured: tuple[str, ...], effects: Collection[str] = (), second: bool = False,
    last: bool = False,
) -> SuperModel:  # fmt: skip
    """`build_supermodel`, kept for the life of the process: a second record of the same plant compiles nothing."""
    key = repr((model, measured, tuple(effects), second, last))
    if key not in _COMPILED:
        if len(_COMPILED) >= 16:
            _COMPILED.clear()
        _COMPILED[key] = build_supermodel(model, measured, effects, second, last)
    return _COMPILED[key]
