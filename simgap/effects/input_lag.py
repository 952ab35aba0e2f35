"""A first-order lag between command and plant."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import MemoryInputEffect
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start, multiple
from simgap.late import sympy as sp


class InputLag(MemoryInputEffect):
    """The actuator follows its command with a time constant."""

    name = "input_lag"
    formula = "u' = z, T dz/dt = u - z"
    source = "Astrom, Murray (2008), Feedback Systems, sec. 3.2"
    rank = COMMAND
    parameters = (EffectParameter("T", "s", "time constant", null=0.0, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """A few multiples of the sampling interval."""
        return tuple(multiple("T", k * scales.interval) for k in (1.0, 4.0, 12.0))

    def lag(self, values: Values) -> sp.Expr:
        """T."""
        return values["T"]

    def describe(self, on: str, quoted: Quoted) -> str:
        """In milliseconds."""
        return f"a lag of {quoted.number('T', 1e3, 'ms')} on {on}"
