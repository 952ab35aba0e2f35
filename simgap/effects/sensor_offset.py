"""A sensor that is off by a constant."""

from __future__ import annotations

from simgap.effects.base import SENSOR, Effect, EffectParameter, Values
from simgap.model.symbolic import SymbolicModel, symbol


class SensorOffset(Effect):
    """The sensor reads the state plus a constant."""

    name = "sensor_offset"
    short = "an offset of the sensor of {on}"
    long = "an offset of {offset} of the sensor of {on}"
    kind = "state"
    formula = "y = x + offset"
    source = "Ljung (1999), System Identification, sec. 14.1"
    rank = SENSOR
    reading_remedy = "Subtract the offset from the readings; the motion itself is unchanged."
    parameters = (EffectParameter("offset", "{state}", "reading minus truth", null=0.0),)

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every state."""
        return model.state_names

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change what the sensor reads; the motion stays as it is."""
        return model.with_output(on, model.outputs.get(on, symbol(on)) + values["offset"])

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """The unit of the state."""
        return {"offset": model.units[on]}
