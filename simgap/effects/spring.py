"""A linear spring about the coordinate's zero."""

from __future__ import annotations

from simgap.effects.base import CoordinateEffect, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp


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
