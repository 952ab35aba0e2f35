"""Short windows of a record."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.thresholds import MIN_SAMPLES
from simgap.errors import UserError


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows over the samples of all traces laid one after another.

    Attributes:
        start, stop: (w,) samples [start, stop) of each window.
        first: (w,) first sample of the window's trace.
        trace: (w,) index of the trace.
    """

    start: Ints
    stop: Ints
    first: Ints
    trace: Ints

    def __len__(self) -> int:
        return len(self.start)

    def pick(self, which: Bools | Ints) -> Windows:
        """Some of the windows: by a mask (w,) or by their numbers."""
        return Windows(self.start[which], self.stop[which], self.first[which], self.trace[which])

    @property
    def samples(self) -> int:
        """Samples of all windows together."""
        return int(np.sum(self.stop - self.start))


def past_the_unknown(windows: Windows, t: Floats, reach_s: float) -> Windows:
    """The windows begun no earlier than `reach_s` after the first sample of their trace; t: (n,) s.

    What was commanded before a trace begins is not in the record; where it still acts, nothing can be compared. Windows
    that become too short are dropped, all are kept as they are if none would be left.
    """
    if reach_s <= 0.0:
        return windows
    start = windows.start.copy()
    for f in np.unique(windows.first):
        own = windows.first == f
        known = f + np.searchsorted(t[f : windows.stop[own].max()], t[f] + reach_s * (1 - 1e-9))
        start[own] = np.maximum(start[own], known)
    kept = windows.stop - start >= MIN_SAMPLES
    return Windows(start, windows.stop, windows.first, windows.trace).pick(kept) if kept.any() else windows


def split_windows(record: Record, seconds: float) -> Windows:
    """Cut every trace into windows of equal length near `seconds`; together they hold every sample once.

    Raises:
        UserError: if no trace is as long as a window.
    """
    rows: list[tuple[int, int, int, int]] = []
    base = 0
    for index, trace in enumerate(record.traces):
        n, duration = len(trace.t), trace.duration
        count = max(1, round(duration / seconds))
        if n >= MIN_SAMPLES and duration >= 0.5 * seconds:
            edges = np.searchsorted(trace.t, trace.t[0] + duration * np.arange(1, count) / count)
            bounds = [0, *edges.tolist(), n]
            for a, b in itertools.pairwise(bounds):
                if b - a >= MIN_SAMPLES:
                    rows.append((base + a, base + b, base, index))
        base += n
    if not rows:
        longest = max((trace.duration for trace in record.traces), default=0.0)
        raise UserError(
            f"no trace is as long as a window of {seconds:g} s (the longest lasts {longest:.3g} s)",
            remedy="Give longer traces or set measured.window_s to less.",
        )
    table = np.array(rows, dtype=np.int64)
    return Windows(*(np.ascontiguousarray(table[:, j]) for j in range(4)))


Span = tuple[int, float, float]
"""(trace, from, to) s: a time that is left out; the sample at `to` is kept."""


def left_out(windows: Windows, t: Floats, spans: tuple[Span, ...]) -> Windows:
    """The windows without those times, cut in two where one lies inside; parts that are too short are dropped.

    All are kept as they are if none would be left. t: (n,) s.
    """
    rows = []
    for a, b, first, trace in zip(windows.start, windows.stop, windows.first, windows.trace, strict=True):
        own = np.ones(b - a, dtype=bool)
        for which, begin, end in spans:
            if which == trace:
                own &= (t[a:b] < begin) | (t[a:b] >= end)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], own.astype(np.int8), [0]])))
        parts = [(a + i, a + j, first, trace) for i, j in zip(edges[::2], edges[1::2], strict=True)]
        rows += [row for row in parts if row[1] - row[0] >= MIN_SAMPLES]
    if not rows:
        return windows
    table = np.array(rows, dtype=np.int64)
    return Windows(*(np.ascontiguousarray(table[:, j]) for j in range(4)))


def cut_at(windows: Windows, t: Floats, spans: tuple[Span, ...]) -> Windows:
    """The windows, cut where a time begins and where it ends if the parts are long enough; t: (n,) s."""
    rows = []
    for a, b, first, trace in zip(windows.start, windows.stop, windows.first, windows.trace, strict=True):
        edges = [int(a)]
        ends = sorted(end for k, *both in spans if k == trace for end in both)
        for cut in (a + np.searchsorted(t[a:b], ends)).tolist():
            if min(cut - edges[-1], b - cut) >= MIN_SAMPLES:
                edges.append(cut)
        rows += [(i, j, first, trace) for i, j in itertools.pairwise([*edges, int(b)])]
    table = np.array(rows, dtype=np.int64)
    return Windows(*(np.ascontiguousarray(table[:, j]) for j in range(4)))


def joined(windows: Windows) -> Windows:
    """Neighbouring windows of a trace as one."""
    a, b = windows.start, windows.stop
    begins = np.ones(len(a), dtype=bool)
    begins[1:] = (a[1:] != b[:-1]) | (windows.trace[1:] != windows.trace[:-1])
    last = np.append(np.flatnonzero(begins)[1:], len(a)) - 1
    return Windows(a[begins], b[last], windows.first[begins], windows.trace[begins])


def stretches(windows: Windows, t: Floats, names: list[str]) -> tuple[tuple[str, float, float], ...]:
    """(trace, from, to) in s, neighbouring windows of a trace joined; t: (n,) s, names: of the traces."""
    whole = joined(windows)
    rows = zip(whole.start.tolist(), whole.stop.tolist(), whole.trace.tolist(), strict=True)
    return tuple((names[k], float(t[a]), float(t[b - 1])) for a, b, k in rows)
