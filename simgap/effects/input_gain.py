"""A wrong actuator constant."""

from __future__ import annotations

import sympy as sp

from simgap.effects.base import EffectParameter, StaticInputEffect, Values


class InputGain(StaticInputEffect):
    """The plant feels a multiple of the command."""

    name = "input_gain"
    formula = "u' = ratio u"
    source = "Ljung (1999), System Identification, sec. 4.2"
    parameters = (EffectParameter("ratio", "1", "true over declared gain", null=1.0, lower=0.0),)

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio u."""
        return values["ratio"] * command
