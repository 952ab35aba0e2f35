"""Time in a recording: stamps of any epoch, jitter, repeats, gaps, masks; a trace becomes uninterrupted pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.config.measured import Mask
from simgap.diagnosis.record.channels import RawTable, unwrap
from simgap.diagnosis.record.record import MIN_SAMPLES
from simgap.errors import UserError, placed
from simgap.units import conversion

_EPOCH_S = 1.0e6  # stamps that start later than this many seconds are counted from their first

_SHORTER = ("ms", "us", "ns")
"""Units that loggers write, from the longest."""


def concerning(masks: Sequence[Mask], file: str, trace: str | None) -> list[Mask]:
    """The masks that are about a trace of a file."""
    return [m for m in masks if (m.file is None or same_file(m.file, file)) and m.trace in (None, trace)]


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
    with placed(file=None if unit else table.file, key="measured.time.unit", remedy="Use s, ms, us or ns."):
        factor = conversion(unit or table.time_unit or "s", "s").factor
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
            remedy="Sort the rows, or separate the traces by a trace column.",
        )


def check_interval(t: Floats, window_s: float, unit: str | None, file: str) -> None:
    """Refuses stamps (n,), ascending, in s, so far apart that no window holds the samples that a fit needs.

    Milliseconds that are taken as seconds are the usual reason, so the unit that they look like is named.

    Raises:
        UserError: naming the interval, the unit and what the recording would be in it.
    """
    steps = np.diff(t)
    steps = steps[steps > 0.0]
    needed = window_s / (MIN_SAMPLES - 1)
    if not steps.size or np.quantile(steps, 0.1) <= needed:
        return
    typical, lasts, read = float(np.median(steps)), float(t[-1] - t[0]), unit or "s"
    factors = {u: conversion(u, "s").factor for u in _SHORTER}
    looks = next((u for u, k in factors.items() if typical * k <= needed and lasts * k > window_s), None)
    if looks is None or conversion(read, "s").factor != 1.0:
        raise UserError(
            f"the stamps are {typical:.3g} s apart (read in {read}), a window of {window_s:g} s needs "
            f"{MIN_SAMPLES} samples",
            file=file, key="measured.time.unit",
            remedy=f"Correct the unit of the stamps, or set measured.window_s to {MIN_SAMPLES * typical:.2g} or more.",
        )  # fmt: skip
    factor = factors[looks]
    raise UserError(
        f"the stamps look like {looks} and are read as s: {typical:.3g} from one to the next and {lasts:.3g} in all; "
        f"in {looks} that is {1.0 / (typical * factor):.3g} samples a second for {lasts * factor:.3g} s",
        file=file,
        key="measured.time.unit",
        remedy=f"Write `time: {{unit: {looks}}}` under `measured:` (if they are s, "
        f"set measured.window_s to {MIN_SAMPLES * typical:.2g} or more).",
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


def kept(t: Floats, masks: Sequence[Mask]) -> Bools:
    """Which stamps the masks leave: (n,) s -> (n,), inside some `keep` (if there is one) and outside every `drop`."""
    keeps, drops = ([r for m in masks if (r := getattr(m, side)) is not None] for side in ("keep", "drop"))
    inside, outside = (np.any([(t >= lo) & (t <= hi) for lo, hi in each], axis=0) for each in (keeps, drops))
    return np.broadcast_to((inside | (not keeps)) & ~outside, t.shape)


def pieces(t: Floats, inside: Bools, limit: float) -> list[slice]:
    """Runs of consecutive stamps (n,) s that are `inside` (n,) and never further apart than `limit` seconds."""
    index = np.flatnonzero(inside)
    if not index.size:
        return []
    breaks = np.flatnonzero((np.diff(index) > 1) | (np.diff(t[index]) > limit)) + 1
    starts, stops = np.append(0, breaks), np.append(breaks, index.size)
    return [slice(int(index[a]), int(index[b - 1]) + 1) for a, b in zip(starts, stops, strict=True)]


_COUNTED = ("repeated", "masked", "gaps", "short_pieces", "short_rows")
"""What of a trace is treated otherwise than used as it is: rows or pieces, as `FileNotes` names them."""


@dataclass(frozen=True, eq=False)
class Split:
    """Pieces of one trace, and how many rows or pieces were treated how.

    Attributes:
        pieces: stamps (n,) and channels (n, m) of each.
        samples: rows with stamps of their own.
        counts: by name, as in `FileNotes`.
        unwrapped: columns that jumped by full turns.
    """

    pieces: tuple[tuple[Floats, Floats], ...]
    samples: int
    counts: Mapping[str, int]
    unwrapped: tuple[int, ...] = ()


def split(
    t: Floats,
    block: Floats,
    turns: Mapping[int, tuple[float, bool | None]],
    masks: Sequence[Mask],
    gap_s: float | None,
    window_s: float,
) -> Split:
    """The pieces of a trace that are at least a window long.

    Args:
        t: (n,) stamps in s, not decreasing.
        block: (n, m) channels.
        turns: for the columns that may be wrapped: a full turn, and whether they are (None: the data decide).
        masks: stretches to keep or to drop.
        gap_s: a longer interval (s) ends a piece; None: five times the one that 95 % of the samples keep.
        window_s: shortest piece (s).
    """
    if not np.any(np.diff(t) > 0.0):
        return Split((), min(t.size, 1), dict(zip(_COUNTED, (0, 0, 0, 1, int(t.size)), strict=True)))
    block, unwrapped = _unwrapped(t, block, turns)  # before repeats are averaged: a mean across a wrap is neither side
    t, block, repeated = merge_repeats(t, block)
    inside = kept(t, masks)
    steps = np.diff(t)
    limit = 5.0 * float(np.quantile(steps, 0.95)) if gap_s is None else gap_s
    out, short = [], []
    for piece in pieces(t, inside, limit):
        long = t[piece.stop - 1] - t[piece.start] >= window_s * (1 - 1e-9) and piece.stop - piece.start >= MIN_SAMPLES
        if long:
            out.append((t[piece], block[piece]))
        else:
            short.append(piece.stop - piece.start)
    masked, gaps = (int(np.count_nonzero(x)) for x in (~inside, (steps > limit) & inside[1:] & inside[:-1]))
    counts = dict(zip(_COUNTED, (repeated, masked, gaps, len(short), sum(short)), strict=True))
    return Split(tuple(out), int(t.size), counts, unwrapped)


def _unwrapped(
    t: Floats, block: Floats, turns: Mapping[int, tuple[float, bool | None]]
) -> tuple[Floats, tuple[int, ...]]:
    steps = np.diff(t)
    typical = float(np.median(steps[steps > 0.0]))
    changed: list[int] = []
    for j, (turn, wrapped) in turns.items():
        straight, jumped = unwrap(block[:, j], steps, typical, turn, wrapped)
        if jumped:
            block = block.copy() if not changed else block
            block[:, j] = straight
            changed.append(j)
    return block, tuple(changed)
