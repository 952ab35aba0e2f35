"""Driven wheels of unequal size."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import PLANT, EffectParameter, Values, WheelEffect
from simgap.effects.quoted import Quoted
from simgap.model.symbolic import SymbolicModel, symbol


class WheelMismatch(WheelEffect):
    """The right wheel of a differential drive is larger or smaller than declared, the left one is as declared."""

    name = "wheel_mismatch"
    short = "unequal wheels"
    formula = "v' = (r (v + w L/2) + (v - w L/2))/2, w' = (r (v + w L/2) - (v - w L/2))/L, L the track, r the ratio"
    source = "Borenstein, Feng (1996), IEEE Trans. Robotics and Automation 12(6), unequal wheel diameters"
    rank = PLANT + 20
    parameters = (EffectParameter("ratio", "1", "true over declared radius of the right wheel", null=1.0, lower=0.0),)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Turn the commands into wheel speeds and back with the true radii."""
        if model.wheels is None:
            return model
        wheels = model.wheels
        v, w, track = symbol(wheels.linear), symbol(wheels.angular), wheels.track
        right, left = values["ratio"] * (v + w * track / 2), v - w * track / 2
        held = model.with_input(wheels.linear, symbol("_linear"))  # both commands change at once
        turned = held.with_input(wheels.angular, (right - left) / track)
        return turned.substitute({"_linear": (right + left) / 2})

    def turned(self, left: float, right: float, values: Mapping[str, float]) -> tuple[float, float]:
        """The right wheel alone."""
        return left, values["ratio"] * right

    def describe(self, on: str, quoted: Quoted) -> str:
        """How far the right wheel is off."""
        return f"a right wheel whose radius is {quoted.deviation()} the declared one"
