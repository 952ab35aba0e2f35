"""An actuator that cannot follow large commands."""

from __future__ import annotations

import math
from collections.abc import Mapping

from simgap.effects.base import COMMAND, EffectParameter, Values, both_sides
from simgap.effects.commands import StaticInputEffect
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class InputSaturation(StaticInputEffect):
    """The plant feels no more than the limit."""

    name = "input_saturation"
    long = "a limit of {limit} on {on}"
    passes_a_constant = False
    formula = "u' = max(-limit, min(u, limit))"
    source = "Tarbouriech et al. (2011), Stability and Stabilization of Linear Systems with Saturating Actuators, ch. 1"
    rank = COMMAND + 10
    parameters = (EffectParameter("limit", "{input}", "largest input", null=math.inf, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Limits at several shares of the largest command."""

        def at(share: float) -> Start:
            return Start(1, lambda c: {"limit": scales.command * share if c[0] > 0.0 else math.inf}, amplitude=1.0)

        return tuple(at(share) for share in (0.95, 0.85, 0.7, 0.5, 0.35))

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u cut to +-limit."""
        limit = values["limit"]
        return sp.Max(-limit, sp.Min(command, limit))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both limits; none where the limit is infinite."""
        return both_sides(symbol(on), values["limit"])
