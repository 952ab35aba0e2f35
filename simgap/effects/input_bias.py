"""An actuator that is off at zero."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import StaticInputEffect
from simgap.late import sympy as sp


class InputBias(StaticInputEffect):
    """The plant feels the command plus a constant."""

    name = "input_bias"
    long = "a bias of {bias} on {on}"
    formula = "u' = u + bias"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = COMMAND + 30
    parameters = (EffectParameter("bias", "{input}", "offset of the input", null=0.0),)
    hides_columns = True

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u + bias."""
        return command + values["bias"]
