"""Friction of a coordinate: viscous, dry (Coulomb, Stribeck, by direction or load), with memory (Dahl, LuGre); drag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.effects.base import (
    FORCE,
    AppliedEffect,
    CoordinateEffect,
    EffectParameter,
    Equal,
    MemoryForceEffect,
    MjcfPlace,
    Scales,
    Start,
    Values,
    beside,
    both_sides,
)
from simgap.effects.commands import DriveEffect
from simgap.effects.forces import steady_biases
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


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


class CoulombFriction(CoordinateEffect):
    """Resistance of constant size against the motion; at rest it holds up to the same size."""

    name = "coulomb_friction"
    dry = True
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


_FLANK = (0.25, 0.5, 1.0, 2.0)  # shares of the Stribeck speed between which the peak falls by exp(-4)


class StribeckFriction(CoordinateEffect):
    """Dry friction that is larger near rest and falls to the Coulomb level as speed grows."""

    name = "stribeck_friction"
    dry = True
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


class LoadFriction(DriveEffect):
    """A share of the drive's force is lost to friction, whichever way it moves: efficiency of a gear."""

    name = "load_friction"
    short = "load-dependent friction of the {on}"
    long = "load-dependent friction of {mu:%} of the {on}"
    passes_a_constant = False
    second = True
    formula = "F = -mu |u| sign(v), u the drive's force on the coordinate"
    source = "Dohring, Lee, Newman (1993), Proc. IEEE ICRA, load-dependent transmission friction"
    rank = FORCE
    excitation = "vary the size of the input, both signs, at one speed"
    parameters = (EffectParameter("mu", "1", "share of the force that is lost", null=0.0, lower=0.0, upper=1.0),)

    def felt(self, drive: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """u - mu |u| sign(v)."""
        return drive - values["mu"] * sp.Abs(drive) * sp.sign(velocity)

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, and no drive."""
        return symbol(on), self.speed(model, on)


class DahlFriction(MemoryForceEffect):
    """Asperities bend before they slide: after a reversal the force turns round over a distance, as a spring does.

    The state z, from -1 to 1, is the bending; far from a reversal it is Coulomb friction.
    """

    name = "dahl_friction"
    dry = True
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
        return tuple(beside("F_c", d=share * scales.speed) for share in (0.006, 0.02, 0.06))

    def rate(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """(v - |v| z) / d."""
        return (velocity - sp.Abs(velocity) * memory) / values["d"]

    def doubt(self, values: Mapping[str, float], visited: Floats) -> str:
        """Friction slides: what only bends wherever the record was is a spring from where it began."""
        if not 0.0 < np.ptp(visited) < values["d"]:
            return ""
        return "it never slides where the record was: a spring would look like it"

    def force(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-F_c z."""
        return -values["F_c"] * memory


_RISE = 0.4  # of the sliding force, to begin at


class LuGreFriction(MemoryForceEffect):
    """Dahl friction with a Stribeck peak and a damper on the bristles.

    The state z is the bending over the one at which the bristles slide, far from rest; viscous friction is an effect of
    its own. The usual numbers are sigma_0 = F_c / d and F_s = (1 + rise) F_c.
    """

    name = "lugre_friction"
    by_name = True  # five numbers beside Dahl's two, for what few records show
    dry = True
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

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The level as a linear coefficient, for a few distances and Stribeck speeds."""
        return tuple(
            beside("F_c", d=d * scales.speed, rise=_RISE, v_s=v * scales.speed, sigma_1=0.0)
            for d in (0.006, 0.02) for v in (0.03, 0.1, 0.3)
        )  # fmt: skip

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


class DirectionalFriction(CoordinateEffect):
    """Resistance of one size forwards and another backwards; at rest it holds whatever lies between.

    The same as Coulomb friction of their mean beside a constant force of half their difference; it is told of beside
    these and not sought by itself.
    """

    name = "directional_friction"
    dry = True
    long = "directional friction at the {on} ({F_p} forwards, {F_m} backwards)"
    contains = CoulombFriction
    formula = "F = -F_p for v > 0, F_m for v < 0, and any force from -F_p to F_m that keeps v = 0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2 (friction asymmetry)"
    excitation = "vary the speed, including slow motion"
    parameters = (
        EffectParameter("F_p", "{force}", "friction force forwards", null=0.0, lower=0.0),
        EffectParameter("F_m", "{force}", "friction force backwards", null=0.0, lower=0.0),
    )

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Nowhere: two effects that are tried are the same."""
        return ()

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """The same level both ways."""
        return {"F_p": contained["F_c"], "F_m": contained["F_c"]}

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """-(F_p + F_m)/2 sign(v) - (F_p - F_m)/2."""
        forwards, backwards = values["F_p"], values["F_m"]
        return -(forwards + backwards) / 2 * sp.sign(velocity) - (forwards - backwards) / 2

    def restates(self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str]) -> Equal:
        """Coulomb friction beside a smaller bias of an input that drives the coordinate, or a constant force."""
        levels = {k: a.values["F_c"] for k, a in enumerate(found) if (a.name, a.on) == ("coulomb_friction", on)}
        pushes = steady_biases(model, on, found)
        pushes |= {k: a.values["F_0"] for k, a in enumerate(found) if (a.name, a.on) == ("constant_force", on)}
        if len(levels) != 1 or len(pushes) != 1:
            return None
        ((i, level),), ((j, push),) = levels.items(), pushes.items()
        if abs(push) > level:
            return None
        return frozenset({i, j}), {"F_p": level - push, "F_m": level + push}
