"""How long the next recording is: which windows of it the diagnosis will look at, and which lengths may be tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Windows, cut_in_folds, needed_ahead
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.errors import UserError

T = TypeVar("T")
LEAST = 16
"""Samples below which no recording is tried: two windows of the fewest samples."""


def windows_to_come(record: Record, settings: DiagnosisSettings, t: Floats) -> tuple[Windows, Bools]:
    """Windows of a recording t (n,) s, given before those at hand, and which of them tell explanations apart, (w,).

    Those of *confirm* do not: no explanation is fitted to them.

    Raises:
        UserError: if the diagnosis cannot use it: it is shorter than half a window, or all of it is held out.
    """
    windows, folds = _to_come(record, settings, t)
    tells = folds[0] | folds[1]
    if not tells.any():
        raise UserError(
            f"of a recording of {t[-1] - t[0]:.3g} s the diagnosis would use nothing to tell explanations apart",
            key="--seconds", remedy=f"Give more, such as {2.0 * settings.window_s:.3g} s.",
        )  # fmt: skip
    return windows, tells


def as_usable(record: Record, settings: DiagnosisSettings, t: Floats, count: int) -> bool:
    """Whether so many samples of a recording t (n,) s are in each of the folds that the whole of it is in.

    Of confusions on a pendulum, an oscillator and a cart with a pole 0 of 6 were settled by less than a window, 13 of
    17 by 1 to 1.4 windows and 29 of 31 by 2.8 and more, the first to be in three folds (benchmarks/next_experiment.py,
    seeds 20000 on): what is found on one fold is not confirmed on another that shows something else.
    """
    try:
        (_, few), (_, whole) = (_to_come(record, settings, part) for part in (t[:count], t))
    except UserError:
        return False
    return bool(np.array_equal(few.any(axis=1), whole.any(axis=1)) and (few[0] | few[1]).any())


def _to_come(record: Record, settings: DiagnosisSettings, t: Floats) -> tuple[Windows, Bools]:
    """Windows of a recording to come, and whether each is in fit, choose and confirm: (3, w)."""
    n = len(t)
    trace = Trace("next", t, np.zeros((n, len(record.measured))), np.zeros((n, len(record.inputs))))
    both = Record((trace, *record.traces), record.measured, record.inputs)
    ahead = needed_ahead(both, settings.window_s, settings.horizon_s)
    windows, folds, _ = cut_in_folds(both, settings.window_s, settings.held_out_traces, settings.held_out_share, ahead)
    own = windows.trace == 0
    return windows.pick(own), np.stack([folds.fit, folds.choose, folds.confirm])[:, own]


def halves(count: int) -> Iterator[int]:
    """Numbers of samples of recordings half, a quarter, ... as long."""
    while count > LEAST:
        count = (count - 1) // 2 + 1
        yield count


def shortest(whole: int, counts: Iterator[int], at: Callable[[int], T | None]) -> T | None:
    """What `at` gives for the least number of samples that is enough for it, else None; None if only `whole` is.

    Ever smaller counts are tried while they are enough, then the one between the last that was and the first that was
    not.
    """
    best: T | None = None
    for count in counts:
        found = at(count)
        if found is None:
            return at(round(math.sqrt(count * whole))) or best
        best, whole = found, count
    return best
