"""Three folds of a record: what effects are fitted to, what chooses among sets of them, and what confirms the answer.

Data that choose among sets flatter the one that they choose: its error there is no longer an error on data that nobody
looked at. So *choose* and *confirm* are apart, and *confirm* is looked at once, at the end. Source: Hastie, Tibshirani,
Friedman (2009), The Elements of Statistical Learning, sec. 7.2.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.record.record import MIN_SAMPLES, Record, runs
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.thresholds import FEWEST_WINDOWS
from simgap.errors import UserError

LOOK_BACK_SAMPLES = 10
"""Samples at least from which the state at the beginning of a prediction is estimated."""
SEVERAL_TRACES = 3
"""From so many traces on, folds are whole traces, one each at least; fewer are cut into blocks of windows."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows over the samples of all traces laid one after another.

    Attributes:
        start, stop: (w,) samples [start, stop) of each window.
        trace: (w,) index of the trace.
    """

    start: Ints
    stop: Ints
    trace: Ints

    def __len__(self) -> int:
        return len(self.start)

    @staticmethod
    def of(rows: Iterable[tuple[int, int, int]]) -> Windows:
        """Windows of (start, stop, trace) each; those of fewer samples than `MIN_SAMPLES` are left out."""
        kept = [row for row in rows if row[1] - row[0] >= MIN_SAMPLES]
        return Windows(*np.ascontiguousarray(np.array(kept, dtype=np.int64).reshape(-1, 3).T))

    def __iter__(self) -> Iterator[tuple[int, int, int]]:
        return zip(self.start.tolist(), self.stop.tolist(), self.trace.tolist(), strict=True)

    def pick(self, which: Bools | Ints) -> Windows:
        """Some of the windows: by a mask (w,) or by their numbers."""
        return Windows(self.start[which], self.stop[which], self.trace[which])

    def begun(self, share: float) -> Windows:
        """The first share of each, `MIN_SAMPLES` at least."""
        whole = self.stop - self.start
        few = np.maximum(np.ceil(share * whole).astype(np.int64), MIN_SAMPLES)
        return replace(self, stop=self.start + np.minimum(few, whole))

    @property
    def samples(self) -> int:
        """Samples of all windows together."""
        return int(np.sum(self.stop - self.start))


def split_windows(record: Record, seconds: float) -> Windows:
    """Cut every trace into windows of equal length near `seconds`; they hold every sample once whose inputs are known.

    Raises:
        UserError: if no trace is as long as a window.
    """
    rows: list[tuple[int, int, int]] = []
    base = 0
    for index, trace in enumerate(record.traces):
        n, duration = len(trace.t), trace.duration
        count = max(1, round(duration / seconds))
        if duration >= 0.5 * seconds:
            edges = np.searchsorted(trace.t, trace.t[0] + duration * np.arange(1, count) / count)
            bounds = [0, *edges.tolist(), n]
            for a, b in itertools.pairwise(bounds):
                known = [(0, b - a)] if trace.told is None else runs(trace.told[a:b])
                rows += [(base + a + i, base + a + j, index) for i, j in known]
        base += n
    windows = Windows.of(rows)
    if not len(windows):
        longest = max((trace.duration for trace in record.traces), default=0.0)
        raise UserError(
            f"no trace is as long as a window of {seconds:g} s (the longest lasts {longest:.3g} s)",
            remedy="Give longer traces or set measured.window_s to less.",
        )
    return windows


Span = tuple[int, float, float]
"""(trace, from, to) s: a time that is left out; the sample at `to` is kept."""


def left_out(windows: Windows, t: Floats, spans: tuple[Span, ...]) -> Windows:
    """The windows without those times, cut in two where one lies inside; parts that are too short are dropped.

    All are kept as they are if none would be left. t: (n,) s.
    """
    rows = []
    for a, b, trace in windows:
        own = np.ones(b - a, dtype=bool)
        for which, begin, end in spans:
            if which == trace:
                own &= (t[a:b] < begin) | (t[a:b] >= end)
        rows += [(a + i, a + j, trace) for i, j in runs(own)]
    found = Windows.of(rows)
    return found if len(found) else windows


def cut_at(windows: Windows, t: Floats, spans: tuple[Span, ...]) -> Windows:
    """The windows, cut where a time begins and where it ends if the parts are long enough; t: (n,) s.

    A part that is too short is dropped where it lies in such a time, and stays with its neighbour where it does not.
    """
    rows = []
    for a, b, trace in windows:
        own = [(x, y) for k, x, y in spans if k == trace]
        edges = [a]
        for cut in [*(a + np.searchsorted(t[a:b], sorted(itertools.chain(*own)))).tolist(), b]:
            inside = cut > edges[-1] and any(x <= t[edges[-1]] and t[cut - 1] <= y for x, y in own)
            if inside or min(cut - edges[-1], b - cut) >= MIN_SAMPLES:
                edges.append(cut)
        if edges[-1] < b:
            edges.append(b)
        rows += [(i, j, trace) for i, j in itertools.pairwise(edges)]
    return Windows.of(rows)


def merged(windows: Windows) -> Windows:
    """Neighbouring windows of a trace as one."""
    a, b = windows.start, windows.stop
    begins = np.ones(len(a), dtype=bool)
    begins[1:] = (a[1:] != b[:-1]) | (windows.trace[1:] != windows.trace[:-1])
    last = np.append(np.flatnonzero(begins)[1:], len(a)) - 1
    return Windows(a[begins], b[last], windows.trace[begins])


def stretches(windows: Windows, t: Floats, names: list[str]) -> tuple[tuple[str, float, float], ...]:
    """(trace, from, to) in s, neighbouring windows of a trace joined; t: (n,) s, names: of the traces."""
    return tuple((names[k], float(t[a]), float(t[b - 1])) for a, b, k in merged(windows))


@dataclass(frozen=True, eq=False)
class Folds:
    """Which windows are of which fold, (w,) each; every window is of one."""

    fit: Bools
    choose: Bools
    confirm: Bools

    @property
    def complete(self) -> bool:
        """Whether each fold has a window."""
        return all(mask.any() for mask in (self.fit, self.choose, self.confirm))


def cut_in_folds(record: Record, settings: DiagnosisSettings, seconds: float) -> tuple[Windows, Folds, float]:
    """Windows of a record, the folds that they are of, and how long they are (s).

    A record that has too few windows of that length for three folds, or fewer than `FEWEST_WINDOWS` that do not
    confirm, is cut into windows of half the length, and so on. Neighbouring windows of a fold are together as long as
    what a prediction needs in one piece: the horizon, and half a window as asked for or as many samples as begin it.

    Args:
        record: the traces.
        settings: what confirms, the horizon and the window that were asked for.
        seconds: length of a window.

    Raises:
        UserError: if windows as short as `MIN_SAMPLES` samples are too few, or for what `split_windows` and
            `confirm_mask` refuse.
    """
    length, names = seconds, [trace.name for trace in record.traces]
    ahead = settings.horizon_s + max(0.5 * settings.window_s, (LOOK_BACK_SAMPLES + 1) * record.interval)
    while True:
        windows, block = split_windows(record, length), max(1, int(np.ceil(ahead / length - 1e-9)))
        folds = split_folds(names, windows, settings.held_out_traces, settings.held_out_share, block)
        shortest = windows.samples < 2 * MIN_SAMPLES * len(windows)
        if folds.complete and (shortest or np.count_nonzero(~folds.confirm) >= FEWEST_WINDOWS):
            return windows, folds, length
        if shortest:
            raise UserError(
                f"{record.rows} samples are too few for the three folds fit, choose and confirm",
                key="measured.held_out",
                remedy="Record longer, or hold out less.",
            )
        length /= 2


def split_folds(names: Sequence[str], windows: Windows, traces: Sequence[str], share: float, block: int = 1) -> Folds:
    """Which windows fit, choose and confirm; names: of the traces.

    Traces stay whole where there are several: among what does not confirm, the last ones choose. Else blocks of `block`
    neighbouring windows choose, midway between those that confirm. A fold may be empty where there is too little.
    """
    confirm = confirm_mask(names, windows, traces, share, block)
    rest = np.unique(windows.trace[~confirm])
    whole = not np.isin(windows.trace[confirm], rest).any()
    if whole and len(rest) > 1:
        choose = np.isin(windows.trace, rest[-min(_part(share, len(rest)), len(rest) - 1) :])
    else:
        choose = _between(windows, confirm, min(share, 0.5 * float(np.mean(~confirm))), block)
    return Folds(~confirm & ~choose, choose, confirm)


def _part(share: float, count: int) -> int:
    return max(1, round(share * count))


def confirm_mask(names: Sequence[str], windows: Windows, traces: Sequence[str], share: float, block: int = 1) -> Bools:
    """Which windows nothing sees before the end: (w,).

    Whole traces where they are named; else whole traces at the end of the record if there are `SEVERAL_TRACES`; else
    blocks of `block` neighbouring windows spread evenly over the record, so that both sides see every kind of motion.

    Raises:
        UserError: if nothing would be left to fit, or nothing is held out by that name.
    """
    present = np.unique(windows.trace)
    held = np.zeros(len(windows), dtype=bool)
    if traces:
        held = np.array([names[k] in traces for k in windows.trace], dtype=bool)
        if not held.any():
            problem = "held_out names no trace that is as long as a window"
            raise UserError(problem, remedy=f"Traces: {', '.join(names)}.")
    elif len(present) >= SEVERAL_TRACES:
        held = np.isin(windows.trace, present[-min(_part(share, len(present)), len(present) - 2) :])
    elif len(windows) > 1:
        block = max(1, min(block, round(share * len(windows))))
        blocks = max(1, round(share * len(windows) / block))
        for centre in (np.arange(blocks) + 0.5) * len(windows) / blocks:
            begin = int(min(max(round(centre - 0.5 * block), 0), len(windows) - block))
            held[begin : begin + block] = True
    if held.all():
        raise UserError(
            "held_out leaves nothing to fit", key="measured.held_out",
            remedy=f"Hold out a smaller share, or fewer of the traces {', '.join(names)}.",
        )  # fmt: skip
    return held


def _between(windows: Windows, taken: Bools, share: float, block: int) -> Bools:
    """Blocks of neighbouring windows of a trace among those not taken, spread evenly: (w,)."""
    count, chosen = len(windows), np.zeros(len(windows), dtype=bool)
    block = max(1, min(block, round(share * count)))
    blocks, open_ = max(1, round(share * count / block)), np.flatnonzero(~taken)
    for centre in open_[((np.arange(blocks) + 0.5) * len(open_) / blocks).astype(np.int64)]:
        free = ~taken & ~chosen
        starts = _runs(windows, free, block)
        if not starts.size or np.count_nonzero(free) <= block:  # something is left to fit
            break
        begin = int(starts[np.argmin(np.abs(starts + 0.5 * (block - 1) - centre))])
        chosen[begin : begin + block] = True
    return chosen if chosen.any() or block == 1 else _between(windows, taken, share, block - 1)


def _runs(windows: Windows, free: Bools, block: int) -> Ints:
    """Where `block` free neighbours of one trace begin."""
    good = sliding_window_view(free, block).all(axis=1)
    if block > 1:
        joined = (windows.start[1:] == windows.stop[:-1]) & (windows.trace[1:] == windows.trace[:-1])
        good &= sliding_window_view(joined, block - 1).all(axis=1)
    return np.flatnonzero(good)
