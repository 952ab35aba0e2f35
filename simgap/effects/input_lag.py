"""A first-order lag between command and plant."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import MemoryInputEffect
from simgap.late import sympy as sp


class InputLag(MemoryInputEffect):
    """The actuator follows its command with a time constant."""

    name = "input_lag"
    long = "a lag of {T} on {on}"
    formula = "u' = z, T dz/dt = u - z"
    source = "Astrom, Murray (2008), Feedback Systems, sec. 3.2"
    begin = (1.0, 4.0, 12.0)
    rank = COMMAND
    parameters = (EffectParameter("T", "s", "time constant", null=0.0, lower=0.0),)

    def lag(self, values: Values) -> sp.Expr:
        """T."""
        return values["T"]
