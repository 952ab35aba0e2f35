"""A linear spring about the coordinate's zero."""

from __future__ import annotations

import sympy as sp

from simgap.effects.base import CoordinateEffect, EffectParameter, Values


class Spring(CoordinateEffect):
    """An elastic element, a cable or a hose that pulls back to zero."""

    name = "spring"
    formula = "F = -k q"
    source = "Hooke's law"
    parameters = (EffectParameter("k", "{force}/{position}", "stiffness", null=0.0, lower=0.0),)

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-k q."""
        return -values["k"] * position
