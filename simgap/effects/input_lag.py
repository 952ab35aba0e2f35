"""A first-order lag between command and plant."""

from __future__ import annotations

from simgap.effects.base import EffectParameter, InputEffect, Values
from simgap.effects.start import Scales, Start, multiple
from simgap.model.symbolic import SymbolicModel, Variable, symbol


class InputLag(InputEffect):
    """The actuator follows its command with a time constant."""

    name = "input_lag"
    formula = "u' = z, T dz/dt = u - z"
    source = "Astrom, Murray (2008), Feedback Systems, sec. 3.2"
    parameters = (EffectParameter("T", "s", "time constant", null=0.0, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """A few multiples of the sampling interval."""
        return tuple(multiple("T", k * scales.interval) for k in (1.0, 4.0, 12.0))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the actuator's output as a state."""
        unit = next(v.unit for v in model.inputs if v.name == on)
        state = f"{on}_lagged"
        lagged = model.with_input(on, symbol(state))
        return lagged.with_state(Variable(state, unit), (symbol(on) - symbol(state)) / values["T"])
