"""An actuator that cannot follow large commands."""

from __future__ import annotations

import math

import sympy as sp

from simgap.effects.base import EffectParameter, StaticInputEffect, Values


class InputSaturation(StaticInputEffect):
    """The plant feels no more than the limit."""

    name = "input_saturation"
    formula = "u' = max(-limit, min(u, limit))"
    source = "Tarbouriech et al. (2011), Stability and Stabilization of Linear Systems with Saturating Actuators, ch. 1"
    parameters = (EffectParameter("limit", "{input}", "largest size of the input", null=math.inf, lower=0.0),)

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u cut to +-limit."""
        limit = values["limit"]
        return sp.Max(-limit, sp.Min(command, limit))
