"""Dry friction of a gear that grows with the torque that it carries."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import FORCE, EffectParameter, Values
from simgap.effects.commands import DriveEffect
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


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
