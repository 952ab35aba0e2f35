"""A pure delay between command and plant."""

from __future__ import annotations

from simgap.effects.base import COMMAND, EffectParameter, Values
from simgap.effects.commands import MemoryInputEffect
from simgap.late import sympy as sp


class InputDelay(MemoryInputEffect):
    """The plant feels what was commanded some time ago (computation, bus, network)."""

    name = "input_delay"
    long = "a delay of {delay} on {on}"
    formula = "u'(t) = u(t - delay)"
    source = "Astrom, Wittenmark (1997), Computer-Controlled Systems, sec. 2.3"
    begin = (0.5, 2.0, 6.0)
    rank = COMMAND + 50
    parameters = (EffectParameter("delay", "s", "time from command to effect", null=0.0, lower=0.0),)

    def delay(self, values: Values) -> sp.Expr:
        """delay."""
        return values["delay"]
