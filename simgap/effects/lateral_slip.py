"""Wheels that slide sideways."""

from __future__ import annotations

from dataclasses import replace

from simgap.effects.base import PLANT, EffectParameter, Values, WheeledTarget
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class LateralSlip(WheeledTarget):
    """The robot drifts to its left by a share of the way it goes forward (the tangent of its side-slip angle)."""

    name = "lateral_slip"
    short = "sideways slip"
    long = "sideways slip of {ratio:%} of the speed"
    formula = "x' += -ratio v sin(heading), y' += ratio v cos(heading)"
    source = "Wang, Low (2008), IEEE Trans. Robotics 24(3), skidding and slipping of wheeled robots"
    rank = PLANT + 30
    parameters = (EffectParameter("ratio", "1", "sideways over forward speed (0 = no slip)", null=0.0),)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the sideways velocity."""
        if model.wheels is None:
            return model
        wheels, names = model.wheels, model.state_names
        sideways, heading = values["ratio"] * symbol(wheels.linear), symbol(wheels.heading)
        xdot = list(model.xdot)
        xdot[names.index(wheels.x)] += -sideways * sp.sin(heading)
        xdot[names.index(wheels.y)] += sideways * sp.cos(heading)
        return replace(model, xdot=tuple(xdot))
