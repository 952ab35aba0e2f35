"""An actuator whose gain differs with the sign of its command."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import StaticInputEffect
from simgap.effects.input_gain import InputGain
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class InputDirectionalGain(StaticInputEffect):
    """One gain for positive commands, another for negative ones: a valve, a thruster, a bridge with unequal legs."""

    name = "input_directional_gain"
    long = "a gain of {on} that differs with the sign ({ratio_p:off} for positive, {ratio_m:off} for negative commands)"
    contains = InputGain
    second = True
    formula = "u' = ratio_p u for u > 0, ratio_m u for u < 0"
    source = "Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2"
    rank = COMMAND + 40
    parameters = (
        EffectParameter("ratio_p", "1", "true over declared gain of positive commands", null=1.0),
        EffectParameter("ratio_m", "1", "true over declared gain of negative commands", null=1.0),
    )

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """The same gain for both."""
        return {"ratio_p": contained["ratio"], "ratio_m": contained["ratio"]}

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio_p (u + |u|)/2 + ratio_m (u - |u|)/2: the other's part is 0 without rounding."""
        up, down = (command + sp.Abs(command)) / 2, (command - sp.Abs(command)) / 2
        return values["ratio_p"] * up + values["ratio_m"] * down

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Where the sign of the command changes."""
        return (symbol(on),)
