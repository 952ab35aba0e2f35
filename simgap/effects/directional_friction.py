"""Dry friction that differs with the direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from simgap.effects.base import AppliedEffect, CoordinateEffect, EffectParameter, Values
from simgap.effects.constant_force import steady_biases
from simgap.effects.coulomb_friction import CoulombFriction
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class DirectionalFriction(CoordinateEffect):
    """Resistance of one size forwards and another backwards; at rest it holds whatever lies between.

    The same as Coulomb friction of their mean beside a constant force of half their difference; it is told of beside
    these and not sought by itself.
    """

    name = "directional_friction"
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

    def restates(
        self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str] = ()
    ) -> tuple[frozenset[int], dict[str, float]] | None:
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

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, where the force turns round."""
        return (symbol(model.coordinate(on).velocity),)
