"""A cubic spring about the coordinate's zero."""

from __future__ import annotations

from simgap.effects.base import CoordinateEffect, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp


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
