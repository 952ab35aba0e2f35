"""Every fault of a recording, by name; what the data alone show in the order in which it is mended."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from simgap.diagnosis.record.faults.base import Fault, Mended, SeenFault
from simgap.diagnosis.record.faults.columns import ConstantColumn, SwappedColumns, WrongSign, WrongUnit
from simgap.diagnosis.record.faults.hum import Hum
from simgap.diagnosis.record.faults.measurement import FITTED
from simgap.diagnosis.record.faults.noise import ColouredNoise, FaintMemory, PlantChanged, Push
from simgap.diagnosis.record.faults.readings import MissingRows, Overflow, SaturatedReading, Spikes, Stale, bridged
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import FoundEffect, RecordingFault
from simgap.model.symbolic import SymbolicModel

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
    record = replace(record, traces=tuple(bridged(trace) for trace in record.traces))
    for fault in faults:
        record, more = fault.mend(record, model)
        found += more
    return record, found


def fitted_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Those that were fitted in the place of effects."""
    return [FITTED[e.name].fitted(e) for e in found if e.name in FITTED]


def gain_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Gains that a wrong sign or unit of the input's column would make as well: a record cannot tell."""
    return [f for e in found for f in (*WrongSign().in_gain(e), *WrongUnit().in_gain(e))]
