"""Coulomb (dry) friction."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import CoordinateEffect, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class CoulombFriction(CoordinateEffect):
    """Resistance of constant size against the motion; at rest it holds up to the same size."""

    name = "coulomb_friction"
    short = "Coulomb friction at the {on}"
    long = "Coulomb friction of {F_c} at the {on}"
    formula = "F = -F_c sign(v), and any |F| <= F_c that keeps v = 0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2"
    excitation = "vary the speed, including slow motion"
    parameters = (EffectParameter("F_c", "{force}", "Coulomb friction force", null=0.0, lower=0.0),)
    hides_columns = True
    mjcf = MjcfPlace("joint", ("frictionloss",))

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-F_c sign(v)."""
        return -values["F_c"] * sp.sign(velocity)

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, where the force turns round."""
        return (symbol(model.coordinate(on).velocity),)
