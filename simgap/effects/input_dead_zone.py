"""An actuator that ignores small commands."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import COMMAND, EffectParameter, Values, both_sides
from simgap.effects.commands import StaticInputEffect
from simgap.effects.start import Scales, Start, multiple
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class InputDeadZone(StaticInputEffect):
    """Commands within the dead zone do nothing, larger ones lose its half-width."""

    name = "input_dead_zone"
    long = "a dead zone of ±({width}) on {on}"
    passes_a_constant = False
    formula = "u' = sign(u) max(|u| - width, 0)"
    source = "Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2"
    rank = COMMAND + 20
    parameters = (EffectParameter("width", "{input}", "half-width of the dead zone", null=0.0, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Widths at a few shares of the largest command."""
        return tuple(multiple("width", share * scales.command) for share in (0.02, 0.07, 0.2))

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u minus its part within +-width."""
        width = values["width"]
        return command - sp.Max(-width, sp.Min(command, width))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both ends of the dead zone."""
        return both_sides(symbol(on), values["width"])
