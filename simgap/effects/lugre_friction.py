"""Dry friction of bristles that bend before they slide and slide the easier the faster they do (LuGre)."""

from __future__ import annotations

from simgap.effects.base import EffectParameter, MemoryForceEffect, Values
from simgap.effects.dahl_friction import DahlFriction
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

_RISE = 0.4  # of the sliding force, to begin at


class LuGreFriction(MemoryForceEffect):
    """Dahl friction with a Stribeck peak and a damper on the bristles.

    The state z is the bending over the one at which the bristles slide, far from rest; viscous friction is an effect of
    its own. The usual numbers are sigma_0 = F_c / d and F_s = (1 + rise) F_c.
    """

    name = "lugre_friction"
    short = "LuGre friction at the {on}"
    long = "LuGre friction of {F_c} at the {on}, {rise:%} more below {v_s}, that turns round over {d}"
    second = True
    contains = DahlFriction
    formula = "F = -F_c z - sigma_1 d dz/dt, dz/dt = (v - |v| z / s(v)) / d, s(v) = 1 + rise exp(-(v/v_s)^2)"
    source = "Canudas de Wit, Olsson, Astrom, Lischinsky (1995), IEEE Trans. Automatic Control 40(3)"
    excitation = "reverse often, with small slow and large fast movements"
    parameters = (
        EffectParameter("F_c", "{force}", "friction force when sliding fast", null=0.0, lower=0.0),
        EffectParameter(
            "d", "{position}", "displacement over which the force reverses", null=0.05, lower=1e-6, shape=True
        ),
        EffectParameter("rise", "1", "breakaway force over F_c, less 1", null=0.4, lower=0.0, shape=True),
        EffectParameter("v_s", "{position}/s", "Stribeck speed", null=0.1, lower=1e-6, shape=True),
        EffectParameter(
            "sigma_1",
            "{force}*s/{position}",
            "damping of the bristles",
            null=0.0,
            lower=0.0,
            shape=True,
            may_vanish=True,
        ),
    )

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Nowhere by itself: five numbers beside Dahl's two, for what few records show."""
        return ()

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The level as a linear coefficient, for a few distances and Stribeck speeds."""

        def at(distance: float, speed: float) -> Start:
            return Start(1, lambda c: {"F_c": c[0], "d": distance, "rise": _RISE, "v_s": speed, "sigma_1": 0.0})

        return tuple(at(d * scales.speed, v * scales.speed) for d in (0.006, 0.02) for v in (0.03, 0.1, 0.3))

    def slip(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """d dz/dt: how fast the bristles bend."""
        peak = 1 + values["rise"] * sp.exp(-((velocity / values["v_s"]) ** 2))
        return velocity - sp.Abs(velocity) * memory / peak

    def rate(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """(v - |v| z / s(v)) / d."""
        return self.slip(memory, velocity, values) / values["d"]

    def force(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-F_c z - sigma_1 d dz/dt."""
        return -values["F_c"] * memory - values["sigma_1"] * self.slip(memory, velocity, values)
