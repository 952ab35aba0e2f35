"""Time stamps as recordings have them: any epoch, jitter, repeats, gaps, stretches that a person masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.table import Floats, RawTable
from simgap.errors import UserError
from simgap.units import conversion

Ints = NDArray[np.int64]
_EPOCH_S = 1.0e6  # stamps that start later than this many seconds are counted from their first


@dataclass(frozen=True)
class TimeRange:
    """A stretch [lo, hi] of a file's time (s) to keep or to drop; `file` and `trace` None mean any."""

    lo: float
    hi: float
    keep: bool
    file: str | None = None
    trace: str | None = None

    def concerns(self, file: str, trace: str | None) -> bool:
        """Whether it is about this trace of this file."""
        return (self.file is None or same_file(self.file, file)) and (self.trace is None or self.trace == trace)


def same_file(wanted: str, file: str) -> bool:
    """Whether `wanted` is the name, the name without suffix, or the end of the path of `file`."""
    parts, ends = file.replace("\\", "/").split("/"), wanted.replace("\\", "/").split("/")
    if parts[-len(ends) :] == ends:
        return True
    stem = [*parts[:-1], parts[-1].rsplit(".", 1)[0]]
    return stem[-len(ends) :] == ends


def seconds(table: RawTable, unit: str | None) -> tuple[Floats, float]:
    """Stamps in seconds, (n,), and the epoch that was taken off them (0 unless they start beyond 10^6 s).

    Raises:
        UserError: if the unit is not one of time.
    """
    try:
        factor = conversion(unit or table.time_unit or "s", "s").factor
    except UserError as error:
        raise UserError(
            error.problem, file=table.file, key="measured.time.unit", remedy="Use s, ms, us or ns."
        ) from None
    first = table.time[0]
    start = float(first) * factor
    relative = (table.time - first).astype(np.float64) * factor  # exact for integer stamps since an epoch
    return (relative, start) if abs(start) > _EPOCH_S else (relative + start, 0.0)


def check_forward(t: Floats, rows: Ints, file: str, trace: str | None) -> None:
    """Refuses time that runs backwards: stamps (n,) of the file's rows (n,), counted from 0.

    Raises:
        UserError: naming the row.
    """
    back = np.flatnonzero(np.diff(t) < 0.0)
    if back.size:
        k = int(back[0])
        of = "" if trace is None else f" of trace '{trace}'"
        raise UserError(
            f"row {int(rows[k + 1]) + 1}: time runs backwards{of}, from {t[k]:.9g} s to {t[k + 1]:.9g} s",
            file=file,
            remedy="Sort the rows, or tell the traces apart with a trace column.",
        )


def merge_repeats(t: Floats, columns: Floats) -> tuple[Floats, Floats, int]:
    """One row for each stamp, the mean of the rows that share it.

    Args:
        t: (n,) stamps, not decreasing.
        columns: (n, m).

    Returns:
        stamps (k,), columns (k, m), rows merged away.
    """
    first = np.flatnonzero(np.concatenate([[True], np.diff(t) > 0.0]))
    if first.size == t.size:
        return t, columns, 0
    counts = np.diff(np.append(first, t.size))
    return t[first], np.add.reduceat(columns, first, axis=0) / counts[:, None], int(t.size - first.size)


def kept(t: Floats, ranges: Sequence[TimeRange]) -> NDArray[np.bool_]:
    """Which stamps the ranges leave: (n,) s -> (n,), inside some `keep` (if there is one) and outside every `drop`."""
    keeps = [r for r in ranges if r.keep]
    inside = np.zeros(t.size, dtype=bool) if keeps else np.ones(t.size, dtype=bool)
    for r in keeps:
        inside |= (t >= r.lo) & (t <= r.hi)
    for r in ranges:
        if not r.keep:
            inside &= ~((t >= r.lo) & (t <= r.hi))
    return inside


def gap_limit(intervals: Floats) -> float:
    """The interval beyond which a trace is split, (n,) s -> s: five times the one that 95 % of the samples keep."""
    return 5.0 * float(np.quantile(intervals, 0.95))


def pieces(t: Floats, inside: NDArray[np.bool_], limit: float) -> list[slice]:
    """Runs of consecutive stamps (n,) s that are `inside` (n,) and never further apart than `limit` seconds."""
    index = np.flatnonzero(inside)
    if not index.size:
        return []
    breaks = np.flatnonzero((np.diff(index) > 1) | (np.diff(t[index]) > limit)) + 1
    starts, stops = np.append(0, breaks), np.append(breaks, index.size)
    return [slice(int(index[a]), int(index[b - 1]) + 1) for a, b in zip(starts, stops, strict=True)]
