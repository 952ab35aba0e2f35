"""Viscous friction."""

from __future__ import annotations

from simgap.effects.base import CoordinateEffect, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp


class ViscousFriction(CoordinateEffect):
    """Resistance proportional to speed."""

    name = "viscous_friction"
    long = "viscous friction of {b} at the {on}"
    formula = "F = -b v"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2"
    excitation = "vary the speed, including slow motion"
    parameters = (EffectParameter("b", "{force}*s/{position}", "viscous coefficient", null=0.0, lower=0.0),)
    hides_columns = True
    mjcf = MjcfPlace("joint", ("damping",))

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-b v."""
        return -values["b"] * velocity
