"""Effects on a planar robot with two driven wheels: unequal wheels, lateral slip, rolling resistance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from simgap.effects.base import (
    PLANT,
    EffectParameter,
    Scales,
    Start,
    Values,
    WheeledTarget,
    WheelEffect,
    both_sides,
    multiple,
    rim_speeds,
)
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


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
        """Commands at which either wheel begins to turn."""
        rims = () if model.wheels is None else rim_speeds(model.wheels)
        return tuple(surface for rim in rims for surface in both_sides(rim, values["loss"]))
