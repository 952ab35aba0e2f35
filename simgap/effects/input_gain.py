"""A wrong actuator constant."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, MjcfPlace, Values
from simgap.effects.commands import StaticInputEffect
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start
from simgap.late import sympy as sp


class InputGain(StaticInputEffect):
    """The plant feels a multiple of the command; a negative one if a wire, a motor or a convention is reversed."""

    name = "input_gain"
    formula = "u' = ratio u"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = COMMAND + 40
    parameters = (EffectParameter("ratio", "1", "true over declared gain", null=1.0),)
    hides_columns = True
    mjcf = MjcfPlace("actuator", ("gear",))
    several_valleys = True

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The declared gain, and its reverse: a wrong sign lies too far away for a derivative."""
        return (*super().starts(scales), Start(1, lambda c: {"ratio": 1.0 - 2.0 * c[0]}, amplitude=1.0))

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio u."""
        return values["ratio"] * command

    def describe(self, on: str, quoted: Quoted) -> str:
        """How far the gain is off, and whether it is reversed."""
        if quoted.value("ratio") < 0.0:
            return f"a reversed {on} (wrong sign), with a gain of {quoted.number('ratio')} times the declared one"
        return f"a gain of {on} that is {quoted.deviation()} the declared one"
