"""Forces that a place or nothing decides: constant, spring, cubic spring, cogging, and a curve over the position."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from simgap.arrays import Floats
from simgap.effects.base import (
    AppliedEffect,
    CoordinateEffect,
    EffectParameter,
    Equal,
    MjcfPlace,
    Quoted,
    Scales,
    Start,
    Values,
    driven_by,
)
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel
from simgap.units import full_turn


class ConstantForce(CoordinateEffect):
    """A steady wind, an unbalanced weight on a slide, the pull of a cable.

    Where an input is a force on the same coordinate it is that input's bias, which is named; it is told of beside it.
    """

    name = "constant_force"
    long = "a constant force of {F_0} at the {on}"
    formula = "F = F_0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2 (offset of the friction)"
    parameters = (EffectParameter("F_0", "{force}", "force", null=0.0),)

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Coordinates on which no input is a force: on others it is the input's bias."""
        return tuple(on for on in self.targets(model) if not driven_by(model, on))

    def restates(self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str]) -> Equal:
        """The bias of an input that drives the coordinate."""
        biases = steady_biases(model, on, found)
        if len(biases) != 1 or any((a.name, a.on) == (self.name, on) for a in found):
            return None
        ((place, level),) = biases.items()
        return frozenset({place}), {"F_0": level}

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """F_0."""
        return values["F_0"]


def steady_biases(model: SymbolicModel, on: str, found: Sequence[AppliedEffect]) -> dict[int, float]:
    """Biases of inputs that reach a coordinate as the same constant force: place among those found -> force."""
    from simgap.effects import effect  # the registry, which imports this module

    changed = {a.on for a in found if not effect(a.name).passes_a_constant}
    return {
        k: a.values["bias"]
        for k, a in enumerate(found)
        if a.name == "input_bias" and model.driven.get(a.on) == on and not changed & {on, a.on}
    }


class Spring(CoordinateEffect):
    """An elastic element, a cable or a hose that pulls back to zero."""

    name = "spring"
    long = "a spring of {k} at the {on}"
    formula = "F = -k q"
    source = "Hooke's law"
    pulls_to_a_place = True
    excitation = "swing wider: their forces differ with the angle"
    parameters = (EffectParameter("k", "{force}/{position}", "stiffness", null=0.0, lower=0.0),)
    mjcf = MjcfPlace("joint", ("stiffness",))

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-k q."""
        return -values["k"] * position


class CubicSpring(CoordinateEffect):
    """The stiffening (k3 > 0) or softening (k3 < 0) part of an elastic element."""

    name = "cubic_spring"
    long = "a cubic spring of {k3} at the {on}"
    formula = "F = -k3 q^3"
    source = "Nayfeh, Mook (1979), Nonlinear Oscillations, sec. 4.1 (Duffing)"
    pulls_to_a_place = True
    excitation = "swing wider: their forces differ with the angle"
    parameters = (EffectParameter("k3", "{force}/{position}^3", "cubic stiffness", null=0.0),)
    mjcf = MjcfPlace("joint", ("stiffness",), power=2)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-k3 q^3."""
        return -values["k3"] * position**3


LEAST_PERIODS = 2  # one period a turn is an unbalanced arm: gravity_tilt and parameter_error
MOST_PERIODS = 16
SEEN_PERIODS = 1.5
"""Of a torsion that grows with the square of the angle 1.2 periods of a ripple were met (and `attributed`), of ripples
that were there 1.9 and more (benchmarks/outside_library.py, benchmarks/undeclared.py). Between is judgement."""


class Cogging(CoordinateEffect):
    """A force that is periodic in the coordinate."""

    name = "cogging"
    formula = "F = A sin(n q + phase)"
    source = "Hanselman (2003), Brushless Permanent Magnet Motor Design, sec. 7 (first harmonic)"
    parameters = (
        EffectParameter("A", "{force}", "amplitude", null=0.0, lower=0.0),
        EffectParameter("n", "1/{position}", "periods in a turn", null=1.0, lower=1.0, integer=True),
        EffectParameter("phase", "rad", "phase at q = 0", null=0.0, shape=True),
    )

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """The coordinates that turn: what slides has no periods in a turn."""
        return tuple(c.name for c in model.coordinates if full_turn(model.units[c.position]) is not None)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Sine and cosine as two linear coefficients, for each number of periods of which the record meets one."""

        def at(n: int) -> Start:
            return Start(2, lambda c: {"A": math.hypot(*c), "n": float(n), "phase": math.atan2(c[1], c[0])})

        met = (scales.places[1] - scales.places[0]) / (2.0 * math.pi)  # of a turn; 0 where no place was read
        return tuple(at(n) for n in range(LEAST_PERIODS, MOST_PERIODS + 1) if not 0.0 < n * met < 1.0)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """A sin(n q + phase)."""
        return values["A"] * sp.sin(values["n"] * position + values["phase"])

    def doubt(self, values: Mapping[str, float], visited: Floats) -> str:
        """A period is seen where the record covers it more than once; before that any bent curve looks like one."""
        covered = float(np.ptp(visited)) * values["n"] / (2.0 * math.pi)
        if not 0.0 < covered < SEEN_PERIODS:
            return ""
        return f"the record covers {covered:.2g} periods of the ripple: a force of another shape would look like it"

    def canonical(self, values: Mapping[str, float]) -> dict[str, float]:
        """The phase within half a turn."""
        return {**values, "phase": (values["phase"] + math.pi) % (2 * math.pi) - math.pi}

    def describe(self, on: str, quoted: Quoted) -> str:
        """Amplitude and periods."""
        n = round(quoted.value("n"))
        return f"cogging of {quoted.number('A')} with {n} period{'' if n == 1 else 's'} a turn at the {on}"


KNOTS = 11
_NAMES = tuple(f"F_{k}" for k in range(KNOTS))


class ForceCurve(CoordinateEffect):
    """A smooth curve of force over place through a few values, evenly spread over where the record was.

    It is what springs, tilts and ripples look alike within: tried in the place of a ripple or of a spring that
    hardens, it tells a curve that only resembles them. Beyond the ends it goes on straight.
    """

    name = "force_curve"
    short = "a force at the {on} that depends on the place"
    second = True
    one_curve = True
    pulls_to_a_place = True
    resembles = ("cogging", "cubic_spring")
    formula = "F = natural cubic spline of q through F_0 ... F_10 between two places"
    source = "Green, Silverman (1994), Nonparametric Regression and Generalized Linear Models, ch. 2"
    parameters = (
        *(EffectParameter(name, "{force}", f"force at place {k} of {KNOTS - 1}", 0.0) for k, name in enumerate(_NAMES)),
        EffectParameter("low", "{position}", "lowest place, taken from the record", null=0.0, integer=True),
        EffectParameter("high", "{position}", "highest place, taken from the record", null=1.0, integer=True),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The values as linear coefficients; none where no place was read."""
        low, high = scales.places
        if not high > low:
            return ()
        return (Start(KNOTS, lambda c: {"low": low, "high": high} | dict(zip(_NAMES, c, strict=True))),)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """The spline in truncated powers, linear in its values."""
        low, high = values["low"], values["high"]
        along = (position - low) / (high - low)
        total: sp.Expr = sp.Integer(0)
        for power, shares in _powers():
            value = sum((sp.Float(s) * values[n] for n, s in zip(_NAMES, shares, strict=True)), sp.Integer(0))
            total += value * (along if power is None else sp.Max(along - sp.Float(power), 0) ** 3)
        return total + values[_NAMES[0]]

    def describe(self, on: str, quoted: Quoted) -> str:
        """Its ends and its middle."""
        first, middle, last = (quoted.number(_NAMES[k]) for k in (0, KNOTS // 2, KNOTS - 1))
        ends = (quoted.value("low"), quoted.value("high"))
        places = [f"{at:.3g}" for at in (ends[0], sum(ends) / 2.0, ends[1])]
        return (
            f"{self.phrase(on)} ({first} at {places[0]}, {middle} at {places[1]}, {last} at {places[2]}; "
            "a table of eleven values)"
        )


@cache
def _powers() -> tuple[tuple[float | None, tuple[float, ...]], ...]:
    """(None for the line, or a knot of ()_+^3) -> what each value gives to its coefficient, on [0, 1]."""
    knots, step = np.linspace(0.0, 1.0, KNOTS, retstep=True)
    values, bends = np.eye(KNOTS), np.zeros((KNOTS, KNOTS))  # bends: second derivatives, none at the ends
    around = 4.0 * np.eye(KNOTS - 2) + np.eye(KNOTS - 2, k=1) + np.eye(KNOTS - 2, k=-1)
    bends[1:-1] = np.linalg.solve(around, 6.0 / step**2 * np.diff(values, 2, axis=0))
    cubes = np.diff(bends, axis=0) / (6.0 * step)
    jumps = np.diff(cubes, axis=0, prepend=0.0, append=0.0)  # of the third derivative over 6: none outside
    line = tuple(((values[1] - values[0]) / step - step / 6.0 * bends[1]).tolist())
    return (None, line), *((float(at), tuple(row.tolist())) for at, row in zip(knots, jumps, strict=True))
