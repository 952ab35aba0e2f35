"""Dry friction of a gear that grows with the torque that it carries."""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp

from simgap.effects.base import FORCE, Effect, EffectParameter, Values, drives
from simgap.effects.quoted import Quoted
from simgap.model.symbolic import SymbolicModel, symbol


class LoadFriction(Effect):
    """A share of the drive's force is lost to friction, whichever way it moves: efficiency of a gear."""

    name = "load_friction"
    kind = "input"
    second = True
    formula = "F = -mu |u| sign(v), u the drive's force on the coordinate"
    source = "Dohring, Lee, Newman (1993), Proc. IEEE ICRA, load-dependent transmission friction"
    rank = FORCE
    excitation = "vary the size of the input, both signs, at one speed"
    parameters = (EffectParameter("mu", "1", "share of the force that is lost", null=0.0, lower=0.0, upper=1.0),)

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Inputs that are a force on a coordinate."""
        return tuple(u for u in model.input_names if drives(model, u) is not None)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the friction on the coordinate that the input drives."""
        coordinate = drives(model, on)
        if coordinate is None:
            return model
        speed = symbol(model.coordinate(coordinate).velocity)
        return model.with_force(coordinate, -values["mu"] * sp.Abs(symbol(on)) * sp.sign(speed))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, and no drive."""
        coordinate = drives(model, on)
        return (symbol(on),) if coordinate is None else (symbol(on), symbol(model.coordinate(coordinate).velocity))

    def phrase(self, on: str) -> str:
        """Named by its drive."""
        return f"load-dependent friction of the {on}"

    def describe(self, on: str, quoted: Quoted) -> str:
        """In percent of the drive's force."""
        return f"load-dependent friction of {quoted.number('mu', 100.0)} % of the {on}"
