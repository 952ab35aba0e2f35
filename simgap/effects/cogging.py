"""Torque that repeats with the position, as of motor magnets or a gear."""

from __future__ import annotations

import math
from collections.abc import Mapping

from simgap.effects.base import CoordinateEffect, EffectParameter, Values
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel
from simgap.units import full_turn

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
        """Sine and cosine as two linear coefficients, for each number of periods."""

        def at(n: int) -> Start:
            return Start(2, lambda c: {"A": math.hypot(*c), "n": float(n), "phase": math.atan2(c[1], c[0])})

        return tuple(at(n) for n in range(LEAST_PERIODS, MOST_PERIODS + 1))

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """A sin(n q + phase)."""
        return values["A"] * sp.sin(values["n"] * position + values["phase"])

    def doubt(self, values: Mapping[str, float], places: tuple[float, float]) -> str:
        """A period is seen where the record covers it more than once; before that any bent curve looks like one."""
        covered = (places[1] - places[0]) * values["n"] / (2.0 * math.pi)
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
