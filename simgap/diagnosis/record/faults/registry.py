"""Every fault of a recording, by name; what the data alone show in the order in which it is mended.

Noise that remembers, and what happens outside the plant and its sensors, is found by the search.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from simgap.diagnosis.record.faults.base import Fault, Mended, SeenFault
from simgap.diagnosis.record.faults.columns import ConstantColumn, SwappedColumns, WrongSign, WrongUnit
from simgap.diagnosis.record.faults.hum import Hum
from simgap.diagnosis.record.faults.measurement import FITTED, Drift
from simgap.diagnosis.record.faults.readings import MissingRows, Overflow, SaturatedReading, Spikes, Stale, bridged
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import FoundEffect, RecordingFault
from simgap.model.symbolic import SymbolicModel


class ColouredNoise(Fault):
    """Noise is correlated in time.

    Detected: after the search, see "Coloured noise" below.
    """

    name = "coloured_noise"
    unit = "s"
    remedy = "Look for a filter, a slow sensor or an interpolation in the path of {}; log its raw readings."

    def of(self, laws: Iterable[tuple[str, float, float]], window_s: float) -> Iterator[RecordingFault]:
        """Findings of channels, each with the share of its variance that remembers, over how long (s).

        What is slower than a window is a zero that wanders.
        """
        for name, share, tau in laws:
            what = f"{100 * share:.0f} % of the noise of {name} (its variance)"
            if share > 0.0 and tau > window_s:
                sentence = f"{what} wanders: a reading that drifts, slower than a window of {window_s:.2g} s."
                remedy = "Warm the sensor up, or zero it at a stop between runs."
                yield Drift().told(name, tau, sentence, remedy, unit="s")
            elif share > 0.0:
                sentence = f"{what} is correlated over {1e3 * tau:.3g} ms"
                yield self.told(name, tau, f"{sentence}; intervals and criteria count what is independent.")


class FaintMemory(Fault):
    """Less than half of a channel's noise is correlated.

    Detected: by a law of the noise, or by what an answer leaves within it (Ljung-Box test, twenty readings, p < 10^-6).
    Effects are then at most `partial`: backlash on a soft spring, or damping that grows with the way, leaves such
    a trace.
    """

    name = "faint_memory"


class Push(Fault):
    """Something acted on the plant for a moment.

    Detected: gross errors follow one another, and no effect explains them; excluded from the fit, see
    [disturbances](../explanation/diagnosis.md#disturbances).
    """

    name = "push"
    unit = "s"
    remedy = "Drop what was disturbed (measured.masks), or repeat the run with nothing touching the plant."


class PlantChanged(Fault):
    """A parameter changed during the recording.

    Detected: after the search, see "Coloured noise" below.
    """

    name = "plant_changed"
    unit = "s"
    remedy = "Diagnose the times before and after apart (measured.masks), or say what differs (measured.conditions)."


READINGS: tuple[SeenFault, ...] = (MissingRows(), Overflow(), SaturatedReading(), Stale(), Spikes())
"""What is no measurement of anything; the order is that of mending, as what repeats looks as a spike does."""
SEEN: tuple[SeenFault, ...] = (*READINGS, Hum(), SwappedColumns())
FAULTS: dict[str, Fault] = {
    f.name: f
    for f in (
        *FITTED.values(), ColouredNoise(), FaintMemory(), WrongSign(), WrongUnit(), *reversed(SEEN), ConstantColumn(),
        Push(), PlantChanged(),
    )
}  # fmt: skip


def mended(record: Record, model: SymbolicModel, faults: Iterable[SeenFault] = SEEN) -> Mended:
    """The record without what a look at it shows to be no measurement, and what was found."""
    found: tuple[RecordingFault, ...] = ()
    record = replace(record, traces=tuple(bridged(trace, trace.compared == 0.0) for trace in record.traces))
    for fault in faults:
        record, more = fault.mend(record, model)
        found += more
    return record, found


def fitted_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Those that were fitted in the place of effects."""
    return [FITTED[e.name].fitted(e) for e in found if e.name in FITTED]


def gain_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Gains that a wrong sign or unit of the input's column would make as well: a record cannot tell."""
    own = WrongSign(), WrongUnit()
    return [f for e in found if e.name == "input_gain" for fault in own for f in fault.in_gain(e)]
