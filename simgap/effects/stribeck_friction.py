"""Coulomb friction with a Stribeck peak."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import CoordinateEffect, EffectParameter, Values, both_sides
from simgap.effects.coulomb_friction import CoulombFriction
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol

_FLANK = (0.25, 0.5, 1.0, 2.0)  # shares of the Stribeck speed between which the peak falls by exp(-4)


class StribeckFriction(CoordinateEffect):
    """Dry friction that is larger near rest and falls to the Coulomb level as speed grows."""

    name = "stribeck_friction"
    short = "Stribeck friction at the {on}"
    long = "Stribeck friction at the {on} ({F_s} to break away, {F_c} when sliding)"
    contains = CoulombFriction
    formula = "F = -(F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v), and any |F| <= F_s that keeps v = 0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. 2"
    excitation = "vary the speed, including slow motion"
    parameters = (
        EffectParameter("F_c", "{force}", "Coulomb friction force", null=0.0, lower=0.0),
        EffectParameter("F_s", "{force}", "breakaway force, at least F_c", null=0.0, lower=0.0),
        EffectParameter("v_s", "{position}/s", "Stribeck speed", null=0.1, lower=1e-06, shape=True),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Coulomb level and peak as two linear coefficients, for a few Stribeck speeds; no peak begins below 0."""

        def at(speed: float) -> Start:
            return Start(2, lambda c: {"F_c": c[0], "F_s": c[0] + max(c[1], 0.0), "v_s": speed})

        return tuple(at(share * scales.speed) for share in (0.03, 0.1, 0.3))

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """A peak of half the Coulomb level on top of it."""
        return {"F_c": contained["F_c"], "F_s": 1.5 * contained["F_c"], "v_s": start["v_s"]}

    def physical(self, values: Mapping[str, float]) -> bool:
        """The peak is not below the Coulomb level."""
        return super().physical(values) and values["F_s"] >= values["F_c"]

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-(F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v)."""
        f_c, f_s, v_s = values["F_c"], values["F_s"], values["v_s"]
        return -(f_c + (f_s - f_c) * sp.exp(-((velocity / v_s) ** 2))) * sp.sign(velocity)

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, where the force turns round, and both flanks of the peak, which may be narrower than a cell."""
        velocity = symbol(model.coordinate(on).velocity)
        return velocity, *both_sides(velocity, *(share * values["v_s"] for share in _FLANK))
