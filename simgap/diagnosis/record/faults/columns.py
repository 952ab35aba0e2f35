"""A position and its velocity that stand in each other's column: the derivative tells, without any model of the plant.

Which of two columns is the derivative of the other is kinematics, so that no missing effect, however large, hides it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.record.survey import VelocityLag, velocity_lag
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import DERIVATIVE_SCALE, EXCHANGED_MISMATCH, MOST
from simgap.model.symbolic import Coordinate


def put_back(record: Record, coordinates: Sequence[Coordinate]) -> tuple[Record, tuple[RecordingFault, ...]]:
    """The record with such columns exchanged, and what was found.

    Columns are exchanged where the one called position is the derivative of the one called velocity, in size and with
    little left, and the other way round is not so.
    """
    faults = []
    for c in coordinates:
        if c.position not in record.measured or c.velocity not in record.measured:
            continue
        as_called, other_way = (
            velocity_lag(record, *names) for names in ((c.position, c.velocity), (c.velocity, c.position))
        )
        if _derivative(other_way, EXCHANGED_MISMATCH) and not _derivative(as_called, MOST):
            record = _exchanged(record, record.measured.index(c.position), record.measured.index(c.velocity))
            faults.append(swap(c.position, c.velocity))
    return record, tuple(faults)


def swap(first: str, second: str) -> RecordingFault:
    """The finding."""
    return RecordingFault(
        "swapped_columns", f"{first}, {second}", None, "",
        f"The columns of {first} and {second} stand in each other's place; they were exchanged.",
        f"Map them with measured.columns.{first}.column and measured.columns.{second}.column.",
    )  # fmt: skip


def _derivative(lag: VelocityLag | None, mismatch: float) -> bool:
    lo, hi = DERIVATIVE_SCALE
    return lag is not None and lo <= lag.scale <= hi and lag.mismatch <= mismatch


def _exchanged(record: Record, i: int, j: int) -> Record:
    order = np.arange(len(record.measured))
    order[[i, j]] = j, i

    def turned(trace: Trace) -> Trace:
        used = None if trace.used is None else trace.used[:, order]
        return replace(trace, y=np.ascontiguousarray(trace.y[:, order]), used=used)

    return replace(record, traces=tuple(turned(trace) for trace in record.traces))
