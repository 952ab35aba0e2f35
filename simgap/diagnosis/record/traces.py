"""From the columns of recordings to traces in the model's units: `(tables, channels, section) -> Reading`.

Nothing is resampled: true intervals are kept. Stamps may be of any epoch and jitter. Repeated ones are merged, gaps and
masks split a trace, pieces shorter than a window are dropped, and every one of these is counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.config.measured import Mask, MeasuredSection
from simgap.diagnosis.record.channels import Channel, RawTable, convert, measured_columns, unwrap
from simgap.diagnosis.record.record import MIN_SAMPLES, Record, Trace
from simgap.diagnosis.thresholds import A_FEW
from simgap.errors import UserError, placed
from simgap.units import conversion


@dataclass(frozen=True)
class FileNotes:
    """What was found in one file and done about it; counts are rows unless said otherwise."""

    file: str
    sha256: str
    rows: int
    rows_used: int
    epoch_s: float
    repeated: int
    masked: int
    gaps: int
    short_pieces: int
    short_rows: int
    unwrapped: tuple[str, ...]
    traces: tuple[str, ...]


@dataclass(frozen=True)
class Reading:
    """Traces, where they came from, which are held out, and what a person should know.

    Attributes:
        origins: trace -> its file and the value of its trace column.
        conditions: trace -> what columns tell of how it was recorded, parameter -> value.
    """

    record: Record
    files: tuple[FileNotes, ...]
    held_out: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    origins: Mapping[str, tuple[str, str | None]] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_traces(
    tables: Sequence[RawTable], channels: Sequence[Channel], section: MeasuredSection, strict: bool = True
) -> Reading:
    """The record that the tables hold.

    Args:
        tables: one per file.
        channels: the states, then the inputs, in the model's order.
        section: masks, gaps, window, held-out data.
        strict: whether held-out data must be among these; else those that are not are passed over with a warning.

    Raises:
        UserError: for a file without a state, an input that is missing, time running backwards, stamps too far apart,
            a single row, or no piece as long as a window; the message names file, row or key, and the remedy.
    """
    headers = [[n for n in table.header if n != section.time.column] for table in tables]  # time is no channel beside
    found = [measured_columns(t.file, h, t.units, channels) for t, h in zip(tables, headers, strict=True)]
    measured = tuple(c.name for c in channels if all(c.name in names for names in found))
    if not measured:
        raise UserError(
            "the files have no measured state in common",
            file=tables[0].file,
            remedy="Give them one at a time, or map their columns under measured.columns.",
        )
    used = [c for c in channels if c.is_input or c.name in measured]
    inputs = tuple(c.name for c in used if c.is_input)
    names = _unique_names([table.file for table in tables])
    traces, notes, said = list[Trace](), list[FileNotes](), list[str]()
    origins: dict[str, tuple[str, str | None]] = {}
    for table, name in zip(tables, names, strict=True):
        own, note, labels, lost = _file_traces(table, name, used, len(measured), section)
        said += [f"{table.file}: {words}" for words in (*table.notes, *lost)]
        traces += own
        notes.append(note)
        origins |= {t.name: (table.file, label) for t, label in zip(own, labels, strict=True)}
    if not traces:
        raise _nothing_left(notes, section)
    record = Record(tuple(traces), measured, inputs)
    held = _held_out(origins, section, strict)
    extra = [[n for n in names if n not in measured] for names in found]
    few = "is not used, because other files do not have it"
    uncommon = [f"{t.file}: {', '.join(e)} {few}" for t, e in zip(tables, extra, strict=True) if e]
    warnings = [*said, *_warnings(notes), *uncommon]
    if not held and (section.held_out.files or section.held_out.traces):
        warnings.append(
            "the data held out by the case are not among these (or are all of them): a share of these is held out"
        )
    return Reading(record, tuple(notes), held, tuple(warnings), origins)


def _file_traces(
    table: RawTable, name: str, used: Sequence[Channel], k: int, section: MeasuredSection
) -> tuple[list[Trace], FileNotes, list[str | None], list[str]]:
    """Traces of one file, and what is told of its rows; the first `k` of the used channels are states."""
    if table.rows < 2:
        raise UserError("has one row", file=table.file, remedy="Give a recording that lasts at least one window.")
    values_of, turns_of = convert(table, used)
    t, epoch = seconds(table, section.time.unit)
    traces, labels, moves = list[Trace](), list[str | None](), False
    counts, turned = np.zeros(len(_COUNTED), dtype=np.int64), set[int]()
    own = [m for m in section.masks if m.file is None or same_file(m.file, table.file)]
    groups = [(label, rows, [m for m in own if m.trace in (None, label)]) for label, rows in by_label(table)]
    empty = np.isnan([values_of[c.name] for c in used])
    said = list(_empty_cells(table.file, used, empty, [rows[kept(t[rows], masks)] for _, rows, masks in groups]))
    for label, every, masks in groups:
        rows = every[~empty[:, every].any(axis=0)]
        check_forward(t[rows], rows, table.file, label)
        check_interval(t[rows], section.window_s, section.time.unit or table.time_unit, table.file)
        block = np.stack([values_of[c.name][rows] for c in used], axis=1)
        turns = {j: turns_of[c.name] for j, c in enumerate(used) if c.name in turns_of}
        found, treated, jumped = split(t[rows], block, turns, masks, section.time.gap_s, section.window_s)
        base = name if label is None else f"{name}:{label}"
        for i, (stamps, values) in enumerate(found):
            traces.append(Trace(base if i == 0 else f"{base}#{i + 1}", stamps, values[:, :k], values[:, k:]))
            labels.append(label)
        counts += treated
        turned |= jumped
        moves |= bool(np.any(np.diff(t[rows])))
    if not moves:
        raise UserError(
            "all rows have one time stamp", file=table.file, remedy="Check measured.time.column and its unit."
        )
    note = FileNotes(
        file=table.file,
        sha256=table.sha256,
        rows=table.rows,
        rows_used=sum(len(trace.t) for trace in traces),
        epoch_s=epoch,
        **dict(zip(_COUNTED, counts.tolist(), strict=True)),
        unwrapped=tuple(c.name for j, c in enumerate(used) if j in turned),
        traces=tuple(trace.name for trace in traces),
    )
    return traces, note, labels, said


def _empty_cells(file: str, used: Sequence[Channel], empty: Bools, traces: Sequence[Ints]) -> Iterator[str]:
    """A note of the rows with an empty cell, which count as missing; empty: (channels, n), traces: rows of each.

    Raises:
        UserError: a trace has no other rows, or there are so many that columns may have been logged at different times.
    """
    every = np.sort(np.concatenate(traces))
    for rows, most in ((every, A_FEW), *((own, 1.0 - 1.0 / max(len(own), 1)) for own in traces)):
        lost = rows[empty[:, rows].any(axis=0)]
        if len(lost) > most * len(rows):
            c = used[int(np.argmax(empty[:, lost[0]]))]
            raise UserError(
                f"row {lost[0] + 1}, '{c.column}': the cell is empty; {len(lost):,} of {len(rows):,} rows "
                f"{'of its trace ' if rows is not every else ''}have one", file=file, key=c.key,
                remedy=f"At most {100 * A_FEW:g} % may: write all columns at common times, or mask such rows.",
            )  # fmt: skip
    if count := int(np.count_nonzero(empty[:, every].any(axis=0))):
        verbs = ("has", "counts") if count == 1 else ("have", "count")
        yield f"{_count(count, 'row')} {verbs[0]} an empty cell and {verbs[1]} as missing"


def by_label(table: RawTable) -> Iterator[tuple[str | None, Ints]]:
    """Rows of each trace of a file, traces in the order in which they first appear."""
    if table.labels is None:
        yield None, np.arange(table.rows)
        return
    values, first, inverse = np.unique(table.labels, return_index=True, return_inverse=True)
    for g in np.argsort(first):
        yield str(values[g]), np.flatnonzero(inverse == g)


def _unique_names(files: Sequence[str]) -> list[str]:
    """Short names of files: the stem, or as much of the path as tells them apart."""
    parts = [f.replace("\\", "/").rsplit(".", 1)[0].split("/") for f in files]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["/".join(p[-depth:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    twice = next(f for f in files if files.count(f) > 1)
    raise UserError("is given twice", file=twice, remedy="Give each recording once.")


def _nothing_left(notes: Sequence[FileNotes], section: MeasuredSection) -> UserError:
    masked = sum(n.masked for n in notes)
    cut = f", after {masked} rows were masked" if masked else ""
    return UserError(
        f"no trace is as long as a window of {section.window_s:g} s"
        f" ({_count(sum(n.short_pieces for n in notes), 'shorter piece')} dropped{cut})",
        file=notes[0].file,
        key="measured.window_s",
        remedy="Record longer, shorten measured.window_s, or correct measured.time.unit, gap_s or the masks.",
    )


def _held_out(origins: Mapping[str, tuple[str, str | None]], section: MeasuredSection, strict: bool) -> tuple[str, ...]:
    """Names of the traces that the case holds out.

    Raises:
        UserError: if it names a file or trace that is not among the data, or if nothing is left to fit.
    """
    chosen: set[str] = set()
    for key, wanted in (("files", section.held_out.files), ("traces", section.held_out.traces)):
        for w in wanted:
            hits = {n for n, (f, label) in origins.items() if (same_file(w, f) if key == "files" else w in (label, n))}
            if strict and not hits:
                raise UserError(
                    f"'{w}' is not among the data",
                    key=f"measured.held_out.{key}",
                    remedy="Name one of " + ", ".join(sorted({f for f, _ in origins.values()} | set(origins))) + ".",
                )
            chosen |= hits
    if chosen and chosen == set(origins):
        if not strict:
            return ()
        raise UserError("holds out every trace", key="measured.held_out", remedy="Leave at least one trace to fit to.")
    return tuple(n for n in origins if n in chosen)


def _warnings(notes: Sequence[FileNotes]) -> Iterator[str]:
    for n in notes:
        if n.repeated:
            yield f"{n.file}: {_count(n.repeated, 'row')} repeated a time stamp: their mean is used"
        if n.gaps:
            yield f"{n.file}: traces are split at {_count(n.gaps, 'gap')} in time"
        if n.short_pieces:
            pieces = _count(n.short_pieces, "piece")
            yield f"{n.file}: {pieces} shorter than a window dropped ({_count(n.short_rows, 'row')})"
        if n.unwrapped:
            yield f"{n.file}: {', '.join(n.unwrapped)} jumped by full turns and was unwrapped"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


_EPOCH_S = 1.0e6  # stamps that start later than this many seconds are counted from their first

_SHORTER = ("ms", "us", "ns")
"""Units that loggers write, from the longest."""


def same_file(wanted: str, file: str) -> bool:
    """Whether `wanted` is the name, the name without suffix, or the end of the path of `file`."""
    parts, ends = (name.replace("\\", "/").split("/") for name in (file, wanted))
    stem = [*parts[:-1], parts[-1].rsplit(".", 1)[0]]
    return ends in (parts[-len(ends) :], stem[-len(ends) :])


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
    widen = f"set measured.window_s to {MIN_SAMPLES * typical:.2g} or more"
    if looks is None or conversion(read, "s").factor != 1.0:
        problem = (
            f"the stamps are {typical:.3g} s apart (read in {read}), a window of {window_s:g} s needs "
            f"{MIN_SAMPLES} samples"
        )
        remedy = f"Correct the unit of the stamps, or {widen}."
    else:
        factor = factors[looks]
        problem = (
            f"the stamps look like {looks} and are read as s: {typical:.3g} from one to the next and {lasts:.3g} in "
            f"all; in {looks} that is {1.0 / (typical * factor):.3g} samples a second for {lasts * factor:.3g} s"
        )
        remedy = f"Write `time: {{unit: {looks}}}` under `measured:` (if they are s, {widen})."
    raise UserError(problem, file=file, key="measured.time.unit", remedy=remedy)


def kept(t: Floats, masks: Sequence[Mask]) -> Bools:
    """Which stamps the masks leave: (n,) s -> (n,), inside some `keep` (if there is one) and outside every `drop`."""
    keeps, drops = ([r for m in masks if (r := getattr(m, side)) is not None] for side in ("keep", "drop"))
    inside, outside = (np.any([(t >= lo) & (t <= hi) for lo, hi in each], axis=0) for each in (keeps, drops))
    return np.broadcast_to((inside | (not keeps)) & ~outside, t.shape)


def pieces(t: Floats, inside: Bools, limit: float) -> list[Ints]:
    """Rows of consecutive stamps (n,) s that are `inside` (n,) and never further apart than `limit` seconds."""
    index = np.flatnonzero(inside)
    breaks = np.flatnonzero((np.diff(index) > 1) | (np.diff(t[index]) > limit)) + 1
    return [rows for rows in np.split(index, breaks) if rows.size]


_COUNTED = ("repeated", "masked", "gaps", "short_pieces", "short_rows")
"""What of a trace is treated otherwise than used as it is: rows or pieces, as `FileNotes` names them."""


def split(
    t: Floats,
    block: Floats,
    turns: Mapping[int, tuple[float, bool | None]],
    masks: Sequence[Mask],
    gap_s: float | None,
    window_s: float,
) -> tuple[list[tuple[Floats, Floats]], tuple[int, ...], set[int]]:
    """The pieces of a trace that are at least a window long, stamps (n,) and channels (n, m) of each.

    Also how many rows or pieces were treated as in `_COUNTED`, and which columns jumped by full turns.

    Args:
        t: (n,) stamps in s, not decreasing.
        block: (n, m) channels.
        turns: for the columns that may be wrapped: a full turn, and whether they are (None: the data decide).
        masks: stretches to keep or to drop.
        gap_s: a longer interval (s) ends a piece; None: five times the one that 95 % of the samples keep.
        window_s: shortest piece (s).
    """
    if not np.any(np.diff(t) > 0.0):
        return [], (0, 0, 0, 1, t.size), set()
    steps, unwrapped, block, rows = np.diff(t), set[int](), block.copy(), t.size
    for j, (turn, wrapped) in turns.items():  # before repeats are averaged: a mean across a wrap is neither side
        block[:, j], jumped = unwrap(block[:, j], steps, float(np.median(steps[steps > 0.0])), turn, wrapped)
        unwrapped |= {j} if jumped else set()
    t, first, alike = np.unique(t, return_index=True, return_counts=True)
    block = np.add.reduceat(block, first, axis=0) / alike[:, None]  # one row for each stamp, the mean of those it has
    inside = kept(t, masks)
    steps = np.diff(t)
    limit = 5.0 * float(np.quantile(steps, 0.95)) if gap_s is None else gap_s
    every = pieces(t, inside, limit)
    long = [p for p in every if t[p[-1]] - t[p[0]] >= window_s * (1 - 1e-9) and len(p) >= MIN_SAMPLES]
    masked, gaps = (int(np.count_nonzero(x)) for x in (~inside, (steps > limit) & inside[1:] & inside[:-1]))
    short_rows = t.size - masked - sum(map(len, long))
    counts = (rows - t.size, masked, gaps, len(every) - len(long), short_rows)
    return [(t[p], block[p]) for p in long], counts, unwrapped
