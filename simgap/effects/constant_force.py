"""A force that is always there."""

from __future__ import annotations

from collections.abc import Sequence

from simgap.effects.base import AppliedEffect, CoordinateEffect, EffectParameter, Values, driven_by, drives
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel


class ConstantForce(CoordinateEffect):
    """A steady wind, an unbalanced weight on a slide, the pull of a cable.

    Where an input is a force on the same coordinate it is that input's bias, which is named; it is told of beside it.
    """

    name = "constant_force"
    long = "a constant force of {F_0} at the {on}"
    formula = "F = F_0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), sec. 2 (offset of the friction)"
    parameters = (EffectParameter("F_0", "{force}", "force", null=0.0),)

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Where no input is a force on the same coordinate: there it is the input's bias."""
        return tuple(on for on in self.targets(model) if not driven_by(model, on))

    def restates(
        self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str] = ()
    ) -> tuple[frozenset[int], dict[str, float]] | None:
        """The bias of an input that drives the coordinate."""
        biases = steady_biases(model, on, found)
        if len(biases) != 1 or any((a.name, a.on) == (self.name, on) for a in found):
            return None
        ((place, level),) = biases.items()
        return frozenset({place}), {"F_0": level}

    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """F_0."""
        return values["F_0"]


def steady_biases(model: SymbolicModel, on: str, found: Sequence[AppliedEffect]) -> dict[int, float]:
    """Biases of inputs that reach a coordinate as the same constant force: place among those found -> force."""
    from simgap.effects import effect  # the registry, which imports this module

    changed = {a.on for a in found if not effect(a.name).passes_a_constant}
    return {
        k: a.values["bias"]
        for k, a in enumerate(found)
        if a.name == "input_bias" and drives(model, a.on) == on and not changed & {on, a.on}
    }
