"""Errors of a sensor: offset and scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from simgap.effects.base import SENSOR, AppliedEffect, Effect, EffectParameter, Equal, Kind, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class SensorEffect(Effect):
    """What a sensor of a state does to its reading; the motion stays as it is."""

    kind: ClassVar[Kind] = "state"
    rank: ClassVar[int] = SENSOR
    source: ClassVar[str] = "Ljung (1999), System Identification, sec. 14.1"

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every state."""
        return model.state_names


class SensorOffset(SensorEffect):
    """The sensor reads the state plus a constant."""

    name = "sensor_offset"
    short = "an offset of the sensor of {on}"
    long = "an offset of {offset} of the sensor of {on}"
    formula = "y = x + offset"
    reading_remedy = "Subtract the offset from the readings; the motion itself is unchanged."
    parameters = (EffectParameter("offset", "{state}", "reading minus truth", null=0.0),)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change what the sensor reads; the motion stays as it is."""
        return model.with_output(on, model.outputs.get(on, symbol(on)) + values["offset"])


LINEAR = {"viscous_friction", "spring", "parameter_error", "reflected_inertia", "input_delay", "input_lag"}


class SensorGain(SensorEffect):
    """The sensor reads a multiple of the state: counts of an encoder, a belt, a potentiometer, a calibration."""

    name = "sensor_gain"
    short = "the gain of the sensor of {on}"
    long = "a gain of the sensor of {on} that is {ratio:off} the declared one"
    second = True
    resembles = ("input_gain",)
    formula = "y = ratio x"
    reading_remedy = "Divide the readings by the gain; the motion itself is unchanged."
    excitation = "swing wider, or measure another state too"
    parameters = (EffectParameter("ratio", "1", "reading over truth", null=1.0, lower=1e-3, upper=1e3),)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change what the sensor reads; the motion stays as it is."""
        return model.with_output(on, values["ratio"] * model.outputs.get(on, symbol(on)))

    def restates(self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str]) -> Equal:
        """The gain of the only input of a linear plant of which this state alone is read."""
        gains = [k for k, a in enumerate(found) if a.name == "input_gain"]
        others = {a.name for k, a in enumerate(found) if k not in gains}
        if tuple(measured) != (on,) or len(model.inputs) != 1 or len(gains) != 1 or not others <= LINEAR:
            return None
        ratio = found[gains[0]].values["ratio"]
        return (frozenset(gains), {"ratio": ratio}) if ratio > 0.0 and is_linear(model) else None


def is_linear(model: SymbolicModel) -> bool:
    """True if the rates are linear in states and inputs, without a constant term."""
    moving = [v.symbol for v in (*model.states, *model.inputs)]
    rates = [sp.expand(e) for e in model.numeric()]
    slopes = [sp.diff(e, v) for e in rates for v in moving]
    rest = [e.subs(dict.fromkeys(moving, 0)) for e in rates]
    return all(s.is_number for s in slopes) and all(sp.simplify(e) == 0 for e in rest)
