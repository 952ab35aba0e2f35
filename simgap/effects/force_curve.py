"""A force that depends on the place alone: a spring that is no straight line, a magnet, a cable, a stop that gives."""

from __future__ import annotations

from functools import cache

import numpy as np

from simgap.effects.base import CoordinateEffect, EffectParameter, Values
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp

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
