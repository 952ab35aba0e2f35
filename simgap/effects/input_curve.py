"""An actuator whose gain changes with the size of its command."""

from __future__ import annotations

from collections.abc import Mapping

from simgap.effects.base import COMMAND, EffectParameter, Values, both_sides
from simgap.effects.commands import StaticInputEffect
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class InputCurve(StaticInputEffect):
    """A static curve, the same for both signs and nowhere falling: magnetic saturation, a valve, a propeller.

    Its slope is linear in u^2 between three knots, at no command, at U/2 and at U, and constant beyond; U is the
    largest command of the record and not fitted. A slope that is nowhere negative makes the curve monotone.
    """

    name = "input_curve"
    short = "the gain curve of {on}"
    long = (
        "a gain of {on} that changes with its size ({g_0} at small, {g_1} at half, {g_2} at full command, of the "
        "declared one)"
    )
    second = True
    resembles = ("input_gain", "input_saturation", "input_dead_zone")
    formula = "du'/du = g, linear in u^2 from g_0 at 0 to g_1 at U/2, from there to g_2 at U"
    source = "Ramsay (1988), Monotone Regression Splines in Action, Statistical Science 3(4)"
    rank = COMMAND + 40
    parameters = (
        EffectParameter("g_0", "1", "true over declared gain of small commands", null=1.0, lower=0.0),
        EffectParameter("g_1", "1", "true over declared gain, for more command, at U/2", null=1.0, lower=0.0),
        EffectParameter("g_2", "1", "true over declared gain, for more command, at U", null=1.0, lower=0.0),
        EffectParameter("U", "{input}", "largest command, taken from the record", null=1.0, lower=1e-12, integer=True),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The three slopes as linear coefficients."""
        names = ("g_0", "g_1", "g_2")
        return (Start(3, lambda c: {"U": scales.command} | {n: 1.0 + v for n, v in zip(names, c, strict=True)}),)

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """The integral of the slope, piece by piece."""
        half, size = values["U"] / 2, sp.Abs(command)
        g_0, g_1, g_2 = values["g_0"], values["g_1"], values["g_2"]
        inner, whole = sp.Min(size, half), sp.Min(size, 2 * half)
        curve = g_0 * inner + (g_1 - g_0) * inner**3 / (3 * half**2)
        curve += g_1 * (whole - inner) + (g_2 - g_1) * ((whole**3 - inner**3) / (9 * half**2) - (whole - inner) / 3)
        curve += g_2 * (size - whole)
        return sp.sign(command) * curve

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Where the curve bends: both signs, their knots."""
        return symbol(on), *both_sides(symbol(on), values["U"] / 2, values["U"])
