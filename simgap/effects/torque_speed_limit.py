"""A motor whose largest force falls with its speed."""

from __future__ import annotations

import math

import sympy as sp

from simgap.effects.base import FORCE, Effect, EffectParameter, Values, drives
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start
from simgap.model.symbolic import SymbolicModel, symbol


class TorqueSpeedLimit(Effect):
    """Supply voltage and back-EMF bound the current: the limit is full at standstill and falls with speed.

    It pushes the faster it is driven backwards; while the limit does not bind, the drive does as commanded.
    """

    name = "torque_speed_limit"
    kind = "input"
    second = True
    formula = "u' = max(-limit - k v, min(u, limit - k v)), v the speed of what it drives"
    source = "Krishnan (2001), Electric Motor Drives, sec. 2.4 (torque-speed characteristic, k = K_t K_e / R)"
    rank = FORCE + 10
    excitation = "command large forces at high speed"
    parameters = (
        EffectParameter("limit", "{force}", "largest force at standstill", null=math.inf, lower=0.0),
        EffectParameter("k", "{force}*s/{position}", "loss of the limit with speed", null=0.0, lower=0.0, shape=True),
    )

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Inputs that are a force on a coordinate."""
        return tuple(u for u in model.input_names if drives(model, u) is not None)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Limits at shares of the largest command, that fall to a half or to nothing at twice the usual speed."""

        def at(limit: float, k: float) -> Start:
            return Start(1, lambda c: {"limit": limit if c[0] > 0.0 else math.inf, "k": k}, amplitude=1.0)

        top, speed = scales.command, 2.0 * scales.speed
        return tuple(at(share * top, lost * share * top / speed) for share in (0.9, 0.6) for lost in (0.5, 1.0))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Bound what the plant feels."""
        coordinate = drives(model, on)
        if coordinate is None:
            return model
        lost, limit = values["k"] * symbol(model.coordinate(coordinate).velocity), values["limit"]
        return model.with_input(on, sp.Max(-limit - lost, sp.Min(symbol(on), limit - lost)))

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Units of the input, and of the coordinate that it drives."""
        unit = next(v.unit for v in model.inputs if v.name == on)
        c = model.coordinate(drives(model, on) or "")
        position = next(v.unit for v in model.states if v.name == c.position)
        return {p.symbol: p.unit.format(force=unit, position=position) for p in self.parameters}

    def phrase(self, on: str) -> str:
        """Named by its drive."""
        return f"a limit of {on} that falls with speed"

    def describe(self, on: str, quoted: Quoted) -> str:
        """Limit and slope."""
        return f"a limit of {on} of {quoted.number('limit')} at standstill, less {quoted.number('k')} with speed"
