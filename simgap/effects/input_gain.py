"""A wrong actuator constant."""

from __future__ import annotations

import sympy as sp

from simgap.effects.base import COMMAND, EffectParameter, StaticInputEffect, Values
from simgap.effects.quoted import Quoted


class InputGain(StaticInputEffect):
    """The plant feels a multiple of the command."""

    name = "input_gain"
    formula = "u' = ratio u"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = COMMAND + 40
    parameters = (EffectParameter("ratio", "1", "true over declared gain", null=1.0, lower=0.0),)

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio u."""
        return values["ratio"] * command

    def describe(self, on: str, quoted: Quoted) -> str:
        """How far the gain is off."""
        return f"a gain of {on} that is {quoted.deviation()} the declared one"
