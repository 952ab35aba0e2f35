"""Where the error is, if a small part of the time carries most of it: a push, a slip, a sample that was lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.result import Concentrated, Stretches
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import A_FEW, MOST
from simgap.diagnosis.verdict.horizon import HorizonError
from simgap.diagnosis.verdict.judge import HeldOut


def concentrated(confirm: Problem, names: Sequence[str], old: HeldOut, new: HeldOut) -> Concentrated | None:
    """Where a small part of the predictions on *confirm* carries most of the squared error that is left.

    Args:
        confirm: the problem; names: of its traces.
        old, new: errors of the declared model and of the one that is judged.

    Returns:
        None where nothing is above the noise, predictions are few, or the error is spread over the time.
    """
    before, after = old.horizon, new.horizon
    if new.at_noise or before is None or after is None or A_FEW * len(after.error) < 1.0:
        return None
    size = np.mean((after.error / confirm.sigma) ** 2, axis=1)
    order = np.argsort(-size)
    carried = np.cumsum(size[order]) / np.sum(size)
    count = int(np.searchsorted(carried, MOST)) + 1
    if count > A_FEW * len(size):
        return None
    bad = np.zeros(len(size), dtype=bool)
    bad[order[:count]] = True
    hit = _touched(after, bad)
    if hit.all():
        return None
    share, medians = _share(before, after, ~hit, confirm.sigma), (_median(before, confirm), _median(after, confirm))
    return Concentrated(_places(confirm, names, after, bad), float(carried[count - 1]), share, *medians)


def _touched(after: HorizonError, bad: Bools) -> Bools:
    """Predictions that overlap a bad one."""
    spans = zip(after.begin[bad], after.end[bad], strict=True)
    return np.any([(after.begin <= b) & (after.end >= a) for a, b in spans], axis=0)


def _share(before: HorizonError, after: HorizonError, which: Bools, sigma: Floats) -> float:
    """Excess after over before, of some of the predictions."""
    was, now = (
        np.mean(np.maximum(np.mean(e.error[which] ** 2, axis=0) - after.floor**2, 0.0) / sigma**2)
        for e in (before, after)
    )
    return float(np.sqrt(now / was)) if was > 0.0 else 1.0


def _median(h: HorizonError, confirm: Problem) -> dict[str, float]:
    return dict(zip(confirm.model.measured, map(float, np.median(np.abs(h.error), axis=0)), strict=True))


def _places(confirm: Problem, names: Sequence[str], after: HorizonError, bad: Bools) -> Stretches:
    """What most of the bad predictions around have in common, as stretches of time."""
    change = np.zeros(len(confirm.t) + 1)
    np.add.at(change, after.begin[bad], 1.0)
    np.add.at(change, after.end[bad] + 1, -1.0)
    cover = np.cumsum(change)[:-1]
    out, k = [], 0
    while k < len(cover):
        if cover[k] == 0.0:
            k += 1
            continue
        stop = k + int(np.argmax(np.append(cover[k:], 0.0) == 0.0))
        core = k + np.flatnonzero(cover[k:stop] > 0.5 * cover[k:stop].max())
        trace = int(np.searchsorted(confirm.firsts, k, side="right")) - 1
        out.append((names[trace], float(confirm.t[core[0]]), float(confirm.t[core[-1]])))
        k = stop
    return tuple(out)
