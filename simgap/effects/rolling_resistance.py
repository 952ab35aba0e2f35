"""Wheels that turn slower than they are told, because their motors give way to what the floor and a caster resist."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simgap.effects.base import PLANT, EffectParameter, WheelEffect, both_sides, rim_speeds
from simgap.effects.start import Scales, Start, multiple
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel


class RollingResistance(WheelEffect):
    """Each driven wheel loses the same speed, whichever way it turns, and stands still where it is told less than that.

    Rolling resistance R, dry as it is, leaves a wheel of radius r under a proportional speed loop of gain K an error of
    R r^2 / K at its rim. A share of the speed that is lost (slip under load) is a gain of the commands instead.
    """

    name = "rolling_resistance"
    short = "rolling resistance of the wheels"
    long = "rolling resistance that takes {loss} from the speed of each wheel"
    second = True
    resembles = ("input_dead_zone", "input_bias", "input_gain")
    formula = "s' = sign(s) max(|s| - loss, 0) for both wheels, s = v + w L/2 and v - w L/2, L the track"
    source = (
        "Wong (2008), Theory of Ground Vehicles, sec. 1.2 (rolling resistance); the rest is the balance of the loop"
    )
    rank = PLANT + 35
    excitation = "drive slowly and fast, turn on the spot and drive backwards"
    parameters = (EffectParameter("loss", "{input}", "speed that each wheel loses at its rim", null=0.0, lower=0.0),)

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """The unit of the commanded speed."""
        return {"loss": "m/s" if model.wheels is None else model.units[model.wheels.linear]}

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Losses at a few shares of the largest commanded speed."""
        return tuple(multiple("loss", share * scales.command) for share in (0.02, 0.08, 0.25))

    def turned(self, left: Any, right: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """Both wheels alike."""
        loss, (least, most) = values["loss"], (min, max) if isinstance(left, float) else (sp.Min, sp.Max)
        return left - most(-loss, least(left, loss)), right - most(-loss, least(right, loss))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Where either wheel begins to turn."""
        rims = () if model.wheels is None else rim_speeds(model.wheels)
        return tuple(surface for rim in rims for surface in both_sides(rim, values["loss"]))
