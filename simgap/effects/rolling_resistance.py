"""Wheels that turn slower than they are told, because their motors give way to what the floor and a caster resist."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import PLANT, EffectParameter, Values, WheelEffect
from simgap.effects.start import Scales, Start, multiple
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


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
        wheels = model.wheels
        return {"loss": next((v.unit for v in model.inputs if wheels is not None and v.name == wheels.linear), "m/s")}

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Losses at a few shares of the largest commanded speed."""
        return tuple(multiple("loss", share * scales.command) for share in (0.02, 0.08, 0.25))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Turn the commands into wheel speeds and back with what the wheels lose."""
        if model.wheels is None:
            return model
        wheels, loss = model.wheels, values["loss"]
        left, right = (s - sp.Max(-loss, sp.Min(s, loss)) for s in _speeds(model))
        held = model.with_input(wheels.linear, symbol("_linear"))  # both commands change at once
        turned = held.with_input(wheels.angular, (right - left) / wheels.track)
        return turned.substitute({"_linear": (right + left) / 2})

    def turned(self, left: float, right: float, values: Mapping[str, float]) -> tuple[float, float]:
        """Both wheels alike."""
        loss = values["loss"]
        return left - max(-loss, min(left, loss)), right - max(-loss, min(right, loss))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Where either wheel begins to turn."""
        if model.wheels is None:
            return ()
        return tuple(s - sp.Float(side * values["loss"]) for s in _speeds(model) for side in (-1.0, 1.0))


def _speeds(model: SymbolicModel) -> tuple[sp.Expr, ...]:
    """Commanded speeds of the left and the right wheel at their rims; none of a plant without wheels."""
    if model.wheels is None:
        return ()
    v, w = symbol(model.wheels.linear), symbol(model.wheels.angular) * model.wheels.track / 2
    return v - w, v + w
