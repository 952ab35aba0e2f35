"""Faults of the measurement equation, which compete with physical effects in one search: late, filtered, drifting.

They are fitted like effects, but they are none: they change nothing in the plant, and no corrected case holds them.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.faults.base import Fault
from simgap.diagnosis.result import FoundEffect, RecordingFault
from simgap.effects import EFFECTS, Effect, EffectParameter, MemoryInputEffect, effect
from simgap.effects.base import COMMAND, SENSOR, Kind, Values
from simgap.effects.sensors import is_linear
from simgap.late import njit
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel


class FittedFault(Fault, Effect):
    """A fault with one number that is 0 where there is none."""

    told_as: ClassVar[str] = ""
    """Under which name a person reads it, if not its own."""

    def fitted(self, found: FoundEffect) -> RecordingFault:
        """The finding, with its number."""
        (size,) = found.parameters.values()
        sentence = f"The recording has {self.describe(found.on, found.quoted)}."
        told = self.told(found.on, size.value, sentence, unit=size.unit)
        return replace(told, fault=self.told_as or self.name)


class LateLog(FittedFault, MemoryInputEffect):
    """An input, or a reading beside the others, has late time stamps.

    Detected: fitted with the effects, one number.
    """

    name = "late_log"
    short, long = "a late log of {on}", "{on} that is logged {late} late"
    begin = (0.5, 2.0, 6.0)
    unit = "s"
    remedy = "Log {} with the stamp of the instant at which it acts, or shift its column by that much."
    formula = "u'(t) = u(t + late)"
    source = "Ljung (1999), System Identification, sec. 14.1"
    rank = COMMAND + 60
    parameters = (EffectParameter("late", "s", "time from action to log", null=0.0, lower=0.0, upper=1.0),)

    def delay(self, values: Values) -> sp.Expr:
        """A delay below zero."""
        return -values["late"]


@dataclass(frozen=True, eq=False)
class Rows:
    """The readings of a channel, window after window.

    Attributes:
        t: (n,) s; since: (n,) s from the start of the trace; first: (w + 1,) first row of each window.
        measured: (n,) recorded, with this noise.
    """

    t: Floats
    since: Floats
    first: Ints
    measured: Floats
    noise: float


class ReadingFault(FittedFault):
    """A fault of one measured channel."""

    kind: ClassVar[Kind] = "state"
    rank: ClassVar[int] = SENSOR + 1
    channels: ClassVar[Literal["every", "position", "velocity"]] = "every"
    """Which states it may be of: of every coordinate its position or its velocity, or any."""
    stands_for: ClassVar[tuple[str, ...]] = ()
    """Names of effects and faults that it looks as: it is tried in their place alone, and from their number."""

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """The states whose reading may have it."""
        if self.channels == "every":
            return model.state_names
        return tuple(getattr(c, self.channels) for c in model.coordinates)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Nothing changes in the plant."""
        return model

    @abstractmethod
    def distort(self, reading: Floats, value: float, at: Rows) -> None:
        """What the channel shows of a true reading, (n,) predicted, in place; value: the number of the fault."""


class Drift(ReadingFault):
    """A sensor's zero moves.

    Detected: a steady ramp is fitted with the effects; a wandering zero competes as coloured noise.
    """

    name = "drift"
    short, long = "a drift of the sensor of {on}", "a sensor of {on} that drifts by {rate}"
    remedy = "Zero the sensor of {} before each run, or subtract the ramp."
    formula = "y(t) = x(t) + rate t"
    source = "Ljung (1999), System Identification, sec. 14.1"
    parameters = (EffectParameter("rate", "{state}/s", "change of the sensor's zero", null=0.0),)

    def distort(self, reading: Floats, value: float, at: Rows) -> None:
        """A ramp from the start of each trace."""
        reading += value * at.since


class _Filtered(ReadingFault):
    """A channel behind a low pass of first order."""

    long = "{on} that was filtered over {lag}"
    unit = "s"
    source = "Oppenheim, Schafer (2010), Discrete-Time Signal Processing, sec. 7.2"
    parameters = (EffectParameter("lag", "s", "time constant of the filter", null=0.0, lower=0.0, upper=1.0),)


class FilteredVelocity(_Filtered):
    """A velocity column was low-pass filtered.

    Detected: fitted with the effects. Where the position is measured too, the column is left out of the fit, because
    the filter is unknown; its error is still reported.
    """

    name = "filtered_velocity"
    channels = "velocity"
    short = "a filter on {on}"
    begin = (1.0, 4.0)
    remedy = "Log {} before its filter, or leave its column out."
    formula = "lag y' = v - y"

    def distort(self, reading: Floats, value: float, at: Rows) -> None:
        """The filter is exact between samples for a steady change; it begins at what was measured."""
        if value > 0.0:
            _filter(reading, value, at.t, at.measured[at.first[:-1]], at.first)

    def left_out(self, on: str, lag: float) -> RecordingFault:
        """The finding of a column that is left out from here on: its lag is told, and the motion is in the position."""
        sentence = f"{on} went through a filter that delays it by about {1e3 * lag:.3g} ms; it was left out."
        return self.told(on, lag, sentence)


class FilteredReading(_Filtered):
    """A position sensor is slow or filtered.

    Detected: tried in place of an input lag or a late reading, and named if it fits better.

    The motion reacts as it would to a slow actuator, which a linear plant that one sensor reads cannot tell at all.
    """

    name = "filtered_reading"
    channels = "position"
    short = "a slow sensor or a filter of {on}"
    begin = ()
    remedy = "Log {} before its filter; of a slow sensor allow for the lag wherever it is fed back."
    formula = "lag y' = x - y"
    stands_for = ("input_lag", "late_reading")

    def distort(self, reading: Floats, value: float, at: Rows) -> None:
        """Exact between samples for a steady change; it begins as it would trail the parabola of the first three
        samples, x - lag x' + lag^2 x''."""
        if value > 0.0:
            t, a = at.t, at.first[:-1]
            one, two = ((reading[a + k] - reading[a]) / (t[a + k] - t[a]) for k in (1, 2))
            bend = (two - one) / (t[a + 2] - t[a + 1])
            begin = reading[a] - value * (one - bend * (t[a + 1] - t[a])) + 2.0 * value**2 * bend
            _filter(reading, value, t, begin, at.first)


class LateReading(ReadingFault):
    """A reading is logged after the others with their stamp.

    Detected: fitted with the effects; reported as `late_log` of the reading.
    """

    name = "late_reading"
    short, long = "a late log of {on}", "{on} that is logged {late} later than the other channels"
    begin = (0.5, 2.0)
    told_as = "late_log"
    unit = "s"
    remedy = "Log {} with the stamp of the instant at which it was read, or shift its column by that much."
    formula = "y(t) = x(t - late)"
    source = "Ljung (1999), System Identification, sec. 14.1"
    parameters = (EffectParameter("late", "s", "time from reading to log", null=0.0, lower=0.0, upper=1.0),)

    def distort(self, reading: Floats, value: float, at: Rows) -> None:
        """Each window as it was a moment before. What was before its start is not known.

        Such readings miss by their noise, so that no delay is better for leaving more of them out; no more than half of
        a window is left out, as else a long delay would stand for anything.
        """
        if value > 0.0:
            _shift(reading, value, at.t, np.ascontiguousarray(at.measured), at.noise, at.first)


@njit("float64(float64[::1], float64[::1], int64, float64)", cache=True)
def _parabola(reading: Floats, t: Floats, j: int, at: float) -> float:
    """Through a sample and those beside it."""
    i, k = j - 1, j + 1
    a, b, c = t[i], t[j], t[k]
    first = reading[i] * (at - b) * (at - c) / ((a - b) * (a - c))
    second = reading[j] * (at - a) * (at - c) / ((b - a) * (b - c))
    return first + second + reading[k] * (at - a) * (at - b) / ((c - a) * (c - b))


@njit("void(float64[::1], float64, float64[::1], float64[::1], float64, int64[::1])", cache=True)
def _shift(reading: Floats, late: float, t: Floats, measured: Floats, noise: float, rows: Ints) -> None:
    for w in range(rows.size - 1):
        a, b = rows[w], rows[w + 1]
        if b - a < 3:
            continue
        before = np.empty(b - a)
        j, back = b - 1, min(late, 0.5 * (t[b - 1] - t[a]))
        for i in range(b - 1, a - 1, -1):
            at = t[i] - back
            while j > a and t[j] > at:
                j -= 1
            m = min(max(j, a + 1), b - 2)
            before[i - a] = _parabola(reading, t, m, at)
            unknown = 0.5 * np.pi * min(max((t[a] - at) / (t[a + 1] - t[a]), 0.0), 1.0)
            if unknown > 0.0:  # squares of misses stay as large as they are by chance
                own, by_chance = measured[i] - before[i - a], noise if (i - a) % 2 else -noise
                before[i - a] = measured[i] - np.cos(unknown) * own - np.sin(unknown) * by_chance
        reading[a:b] = before


@njit("void(float64[::1], float64, float64[::1], float64[::1], int64[::1])", cache=True)
def _filter(reading: Floats, lag: float, t: Floats, begin: Floats, rows: Ints) -> None:
    for w in range(rows.size - 1):
        a, b = rows[w], rows[w + 1]
        out, last = begin[w], reading[a]
        reading[a] = out
        for i in range(a + 1, b):
            dt, now = t[i] - t[i - 1], reading[i]
            ramp = lag * (now - last) / dt
            out = now - ramp + (out - last + ramp) * np.exp(-dt / lag)
            last = now
            reading[i] = out


FITTED: dict[str, FittedFault] = {
    e.name: e for e in (LateLog(), Drift(), FilteredVelocity(), LateReading(), FilteredReading())
}
"""By name; no name is that of an effect."""
_RELATIVE = ("filtered_velocity", "late_reading")


def possible(model: SymbolicModel, measured: tuple[str, ...]) -> list[tuple[Effect, str]]:
    """Faults that a record of these channels may have, and of which channel.

    A filter on a velocity alone is what a slow actuator would do, a late reading alone what a late one would: it takes
    another channel to tell. So does a slow sensor of a linear plant.
    """
    found = [(e, on) for e in FITTED.values() for on in e.targets(model) if e.kind == "input" or on in measured]
    alone = set() if len(measured) > 1 else {*_RELATIVE, *(("filtered_reading",) if is_linear(model) else ())}
    return [(e, on) for e, on in found if e.name not in alone]


def is_fault(name: str) -> bool:
    """Whether a name is that of a fitted fault of the recording."""
    return name in FITTED


def effect_or_fault(name: str) -> Effect:
    """The effect or the fault of that name.

    Raises:
        UserError: for a name that is neither's.
    """
    return FITTED[name] if name in FITTED and name not in EFFECTS else effect(name)
