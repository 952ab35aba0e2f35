"""Three folds of a record: what effects are fitted to, what chooses among sets of them, and what confirms the answer.

Data that choose among sets flatter the one that they choose: its error there is no longer an error on data that nobody
looked at. So *choose* and *confirm* are apart, and *confirm* is looked at once, at the end. Source: Hastie, Tibshirani,
Friedman (2009), The Elements of Statistical Learning, sec. 7.2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from simgap.arrays import Bools, Ints
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.windows import Windows, split_windows
from simgap.diagnosis.thresholds import MIN_SAMPLES, SEVERAL_TRACES
from simgap.errors import UserError


@dataclass(frozen=True, eq=False)
class Folds:
    """Which windows are of which fold, (w,) each; every window is of one."""

    fit: Bools
    choose: Bools
    confirm: Bools

    @property
    def complete(self) -> bool:
        """Whether each fold has a window."""
        return all(bool(getattr(self, f.name).any()) for f in fields(self))


def cut_in_folds(
    record: Record, seconds: float, traces: tuple[str, ...], share: float, ahead_s: float
) -> tuple[Windows, Folds, float]:
    """Windows of a record, the folds that they are of, and how long they are (s).

    A record that has too few windows of that length for three folds is cut into windows of half the length, and so on.

    Args:
        record: the traces.
        seconds: length of a window.
        traces: names of traces that confirm; if empty, `share` of the record does.
        share: of traces or windows that confirm.
        ahead_s: what a prediction needs in one piece, s: neighbouring windows of a fold are as long together.

    Raises:
        UserError: if windows as short as `MIN_SAMPLES` samples are too few, or for what `split_windows` and
            `confirm_mask` refuse.
    """
    length = seconds
    while True:
        windows = split_windows(record, length)
        folds = split_folds(record, windows, traces, share, max(1, int(np.ceil(ahead_s / length - 1e-9))))
        if folds.complete:
            return windows, folds, length
        if windows.samples < 2 * MIN_SAMPLES * len(windows):
            raise UserError(
                f"{record.rows} samples are too few for the three folds fit, choose and confirm",
                key="measured.held_out",
                remedy="Record for longer, or hold out less.",
            )
        length /= 2


def split_folds(record: Record, windows: Windows, traces: tuple[str, ...], share: float, block: int = 1) -> Folds:
    """Which windows fit, choose and confirm.

    Traces stay whole where there are several: among what does not confirm, the last ones choose. Else blocks of `block`
    neighbouring windows choose, midway between those that confirm. A fold may be empty where there is too little.
    """
    confirm = confirm_mask(record, windows, traces, share, block)
    rest = np.unique(windows.trace[~confirm])
    whole = not np.isin(windows.trace[confirm], rest).any()
    if whole and len(rest) > 1:
        choose = np.isin(windows.trace, rest[-min(_part(share, len(rest)), len(rest) - 1) :])
    else:
        choose = _between(windows, confirm, min(share, 0.5 * float(np.mean(~confirm))), block)
    return Folds(~confirm & ~choose, choose, confirm)


def _part(share: float, count: int) -> int:
    return max(1, round(share * count))


def confirm_mask(record: Record, windows: Windows, traces: tuple[str, ...], share: float, block: int = 1) -> Bools:
    """Which windows nothing sees before the end: (w,).

    Whole traces where they are named; else whole traces at the end of the record if there are `SEVERAL_TRACES`; else
    blocks of `block` neighbouring windows spread evenly over the record, so that both sides see every kind of motion.

    Raises:
        UserError: if nothing would be left to fit, or nothing is held out by that name.
    """
    present = np.unique(windows.trace)
    held = np.zeros(len(windows), dtype=bool)
    if traces:
        names = [trace.name for trace in record.traces]
        held = np.array([names[k] in traces for k in windows.trace], dtype=bool)
        if held.all() or not held.any():
            word = "leaves nothing to fit" if held.all() else "names no trace that is as long as a window"
            raise UserError(f"held_out {word}", remedy=f"Traces: {', '.join(names)}.")
    elif len(present) >= SEVERAL_TRACES:
        held = np.isin(windows.trace, present[-min(_part(share, len(present)), len(present) - 2) :])
    elif len(windows) > 1:
        block = max(1, min(block, round(share * len(windows))))
        blocks = max(1, round(share * len(windows) / block))
        for centre in (np.arange(blocks) + 0.5) * len(windows) / blocks:
            begin = int(min(max(round(centre - 0.5 * block), 0), len(windows) - block))
            held[begin : begin + block] = True
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
    if len(free) < block:
        return np.zeros(0, dtype=np.int64)
    good = sliding_window_view(free, block).all(axis=1)
    if block > 1:
        joined = (windows.start[1:] == windows.stop[:-1]) & (windows.trace[1:] == windows.trace[:-1])
        good &= sliding_window_view(joined, block - 1).all(axis=1)
    return np.flatnonzero(good)
