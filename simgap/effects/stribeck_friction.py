"""Coulomb friction with a Stribeck peak."""

from __future__ import annotations

import sympy as sp

from simgap.effects.base import CoordinateEffect, EffectParameter, Values


class StribeckFriction(CoordinateEffect):
    """Dry friction that is larger near rest and falls to the Coulomb level as speed grows."""

    name = "stribeck_friction"
    formula = "F = -(F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v), and any |F| <= F_s that keeps v = 0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. 2"
    parameters = (
        EffectParameter("F_c", "{force}", "Coulomb friction force", null=0.0, lower=0.0),
        EffectParameter("F_s", "{force}", "breakaway force, at least F_c", null=0.0, lower=0.0),
        EffectParameter("v_s", "{position}/s", "Stribeck speed", null=0.1, lower=1e-06),
    )

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-(F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v)."""
        f_c, f_s, v_s = values["F_c"], values["F_s"], values["v_s"]
        return -(f_c + (f_s - f_c) * sp.exp(-((velocity / v_s) ** 2))) * sp.sign(velocity)
