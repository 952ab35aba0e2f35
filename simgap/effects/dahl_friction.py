"""Dry friction that remembers where the motion turned round (Dahl)."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import EffectParameter, MemoryForceEffect, Values
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp


class DahlFriction(MemoryForceEffect):
    """Asperities bend before they slide: after a reversal the force turns round over a distance, as a spring does.

    The state z, from -1 to 1, is the bending; far from a reversal it is Coulomb friction.
    """

    name = "dahl_friction"
    short = "Dahl friction at the {on}"
    long = "Dahl friction of {F_c} at the {on} that turns round over {d}"
    second = True
    formula = "F = -F_c z, dz/dt = (v - |v| z) / d"
    source = "Dahl (1968), A Solid Friction Model, Aerospace Corp. TOR-0158(3107-18)-1 (i = 1, stiffness F_c / d)"
    excitation = "reverse often, with small and large movements"
    parameters = (
        EffectParameter("F_c", "{force}", "friction force when sliding", null=0.0, lower=0.0),
        EffectParameter(
            "d", "{position}", "displacement over which the force reverses", null=0.05, lower=1e-6, shape=True
        ),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The level as a linear coefficient, for distances travelled in a few hundredths of a second."""

        def at(distance: float) -> Start:
            return Start(1, lambda c: {"F_c": c[0], "d": distance})

        return tuple(at(share * scales.speed) for share in (0.006, 0.02, 0.06))

    def rate(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """(v - |v| z) / d."""
        return (velocity - sp.Abs(velocity) * memory) / values["d"]

    def doubt(self, values: Mapping[str, float], places: tuple[float, float]) -> str:
        """Friction slides: what only bends wherever the record was is a spring from where it began."""
        travel = places[1] - places[0]
        if not 0.0 < travel < values["d"]:
            return ""
        return "it never slides where the record was: a spring would look like it"

    def force(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-F_c z."""
        return -values["F_c"] * memory
