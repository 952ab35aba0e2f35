"""A motor at the limit of its voltage: what it can give falls with its speed, by its back-EMF."""

from __future__ import annotations

import math
from collections.abc import Mapping

from simgap.effects.base import EffectParameter, Values, both_sides
from simgap.effects.commands import DriveEffect
from simgap.effects.input_saturation import InputSaturation
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class TorqueSpeedLimit(DriveEffect):
    """The torque-speed line: a stall torque at rest, less as the motor drives faster, more where it brakes.

    With the largest voltage V, resistance R and motor constant K: T_s = K V / R and k = K^2 / R, both by the gear.
    """

    name = "torque_speed_limit"
    short = "the torque-speed limit of {on}"
    long = "a torque-speed limit of {on} ({T_s} at rest, less {k} times the speed)"
    passes_a_constant = False
    contains = InputSaturation
    second = True
    several_valleys = True
    resembles = ("input_saturation",)
    formula = "u' = max(-T_s - k v, min(u, T_s - k v))"
    source = "Spong, Hutchinson, Vidyasagar (2006), Robot Modeling and Control, sec. 6.1 (torque-speed curve)"
    excitation = "command large inputs at rest and at speed, driving and braking"
    parameters = (
        EffectParameter("T_s", "{input}", "largest input at rest", null=math.inf, lower=0.0),
        EffectParameter("k", "{input}*s/{position}", "decrease of the limit with speed", null=0.0, lower=0.0),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Stall torques at shares of the largest command, and speeds at which nothing is left of them."""

        def at(share: float, idle: float) -> Start:
            stall = share * scales.command
            there, none = {"T_s": stall, "k": stall / (idle * scales.speed)}, {"T_s": math.inf, "k": 0.0}
            return Start(1, lambda c: dict(there if c[0] > 0.0 else none), amplitude=1.0)

        return tuple(at(share, idle) for share, idle in ((1.5, 3.0), (1.2, 6.0), (0.9, 4.0), (0.9, 8.0), (0.6, 6.0)))

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """A line through the limit that was found at the start's slope, a third above it at rest."""
        stall = 4.0 / 3.0 * contained["limit"]
        return {"T_s": stall, "k": stall * start["k"] / start["T_s"]}

    def felt(self, drive: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """u cut to -T_s - k v and T_s - k v."""
        stall, fall = values["T_s"], values["k"] * velocity
        return sp.Max(-stall - fall, sp.Min(drive, stall - fall))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both limits; none where they are infinite."""
        return both_sides(symbol(on) + sp.Float(values["k"]) * self.speed(model, on), values["T_s"])
