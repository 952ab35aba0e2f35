"""Drag that grows with the square of speed."""

from __future__ import annotations

from simgap.effects.base import CoordinateEffect, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp


class QuadraticDrag(CoordinateEffect):
    """Resistance of a fluid at high Reynolds number."""

    name = "quadratic_drag"
    long = "quadratic drag of {c} at the {on}"
    formula = "F = -c v |v|"
    source = "Batchelor (1967), An Introduction to Fluid Dynamics, sec. 5.11"
    excitation = "vary the speed, including slow motion"
    parameters = (EffectParameter("c", "{force}*s^2/{position}^2", "drag coefficient", null=0.0, lower=0.0),)
    mjcf = MjcfPlace("joint", ("damping",), power=1)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-c v |v|."""
        return -values["c"] * velocity * sp.Abs(velocity)
