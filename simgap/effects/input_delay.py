"""A pure delay between command and plant."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import MemoryInputEffect
from simgap.effects.quoted import Quoted
from simgap.effects.start import Scales, Start, multiple
from simgap.late import sympy as sp


class InputDelay(MemoryInputEffect):
    """The plant feels what was commanded some time ago (computation, bus, network)."""

    name = "input_delay"
    formula = "u'(t) = u(t - delay)"
    source = "Astrom, Wittenmark (1997), Computer-Controlled Systems, sec. 2.3"
    rank = COMMAND + 50
    parameters = (EffectParameter("delay", "s", "time from command to effect", null=0.0, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """A few multiples of the sampling interval."""
        return tuple(multiple("delay", k * scales.interval) for k in (0.5, 2.0, 6.0))

    def delay(self, values: Values) -> sp.Expr:
        """delay."""
        return values["delay"]

    def describe(self, on: str, quoted: Quoted) -> str:
        """In milliseconds."""
        return f"a delay of {quoted.number('delay', 1e3, 'ms')} on {on}"
