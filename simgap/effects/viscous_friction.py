"""Viscous friction."""

from __future__ import annotations

import sympy as sp

from simgap.effects.base import CoordinateEffect, EffectParameter, Values


class ViscousFriction(CoordinateEffect):
    """Resistance proportional to speed."""

    name = "viscous_friction"
    formula = "F = -b v"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2"
    parameters = (EffectParameter("b", "{force}*s/{position}", "viscous coefficient", null=0.0, lower=0.0),)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-b v."""
        return -values["b"] * velocity
