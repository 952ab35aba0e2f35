"""Driven wheels of unequal size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simgap.effects.base import PLANT, EffectParameter, WheelEffect


class WheelMismatch(WheelEffect):
    """The right wheel of a differential drive is larger or smaller than declared, the left one is as declared."""

    name = "wheel_mismatch"
    short = "unequal wheels"
    long = "a right wheel whose radius is {ratio:off} the declared one"
    formula = "v' = (r (v + w L/2) + (v - w L/2))/2, w' = (r (v + w L/2) - (v - w L/2))/L, L the track, r the ratio"
    source = "Borenstein, Feng (1996), IEEE Trans. Robotics and Automation 12(6), unequal wheel diameters"
    rank = PLANT + 20
    parameters = (EffectParameter("ratio", "1", "true over declared radius of the right wheel", null=1.0, lower=0.0),)

    def turned(self, left: Any, right: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """The right wheel alone."""
        return left, values["ratio"] * right
