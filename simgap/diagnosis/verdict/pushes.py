"""A few windows in which something else acts than in all others: a push, a knock, a stop that was hit.

Least squares trusts every window alike, so that one that was pushed outweighs the rest and bends every fit. Windows
that stand out under what was found are set aside, the rest is searched again, until the same windows stand out: the
concentration steps of least trimmed squares. Source: Rousseeuw, Leroy (1987), Robust Regression and Outlier
Detection, sec. 1.2; Rousseeuw, Van Driessen (2006), Data Mining and Knowledge Discovery 12(1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.windows import Windows, stretches
from simgap.diagnosis.result import RecordingFault, Stretches
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit_from_all
from simgap.diagnosis.thresholds import (
    FAR,
    FEWEST_WINDOWS,
    LOOK_BACK_S,
    MOST_ASIDE,
    MOST_OF_A_PUSH,
    MOST_OF_THE_ERROR,
)
from simgap.diagnosis.verdict.horizon import horizon_error
from simgap.diagnosis.verdict.judge import HeldOut, at_noise, judge
from simgap.notation import joined

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
_AHEAD_S = 0.1  # a push is located to about this
_WORST = 0.01  # of the largest squared error in its windows


def worst(problem: Problem, theta: Floats) -> Mask:
    """The windows (w,) that miss most at theta (q,), as many as may be set aside: where to begin.

    What is missing everywhere makes windows miss by very different amounts, so that none need stand out yet.
    """
    size, over = _sizes(problem, theta)
    out = np.zeros(len(size), dtype=bool)
    if len(size) >= FEWEST_WINDOWS:
        out[np.argsort(-size)[: _most(len(size))]] = True
    return out if over[out].sum() >= MOST_OF_A_PUSH * over.sum() > 0.0 else np.zeros_like(out)


def standing_out(problem: Problem, theta: Floats) -> Mask:
    """Windows (w,) whose chi^2 stands far out, initial states fitted at theta (q,); none where they are many.

    Together they carry most of chi^2, or nothing is gained by setting them aside.
    """
    size, over = _sizes(problem, theta)
    far = size > FAR * max(float(np.median(size)), 1.0)
    few = len(size) >= FEWEST_WINDOWS and int(far.sum()) <= _most(len(size))
    return far if few and over[far].sum() >= MOST_OF_THE_ERROR * over.sum() > 0.0 else np.zeros_like(far)


def _most(windows: int) -> int:
    return max(int(MOST_ASIDE * windows), 2)


def _sizes(problem: Problem, theta: Floats) -> tuple[Floats, Floats]:
    """chi^2/dof of each window and its chi^2 above noise, (w,) each, initial states fitted."""
    chi2 = refit_from_all(problem, theta, initial_states(problem)).chi2
    return chi2 / np.maximum(problem.counts - problem.model.nx, 1.0), np.maximum(chi2 - problem.counts, 0.0)


@dataclass(frozen=True, eq=False)
class Confirmed:
    """What *confirm* says of the model as declared and of the corrected one.

    Attributes:
        problem: *confirm*, without windows in which something else acts; old, new: errors there.
        apart: those windows; None: there are none.
    """

    problem: Problem
    old: HeldOut
    new: HeldOut
    apart: Windows | None = None


def confirmed(
    confirm: Problem, old: HeldOut, new: HeldOut, thetas: tuple[Floats, Floats], horizon_s: float
) -> Confirmed:
    """*confirm* without windows that stand out under the corrected model, where the others are down to their noise.

    Which they are is a matter of that model, which was chosen without *confirm*, and of limits that hold for all.

    Args:
        confirm: all of it; old, new: errors there; thetas: of the declared and the corrected model, (q,) each.
        horizon_s: of the judgement.
    """
    far = np.zeros(0, dtype=bool) if at_noise(new) else standing_out(confirm, thetas[1])
    if not far.any():
        return Confirmed(confirm, old, new)
    calm = confirm.on(confirm.windows.pick(~far))
    was, now = (judge(calm, theta, horizon_s) for theta in thetas)
    if not at_noise(now):
        return Confirmed(confirm, old, new)
    return Confirmed(calm, was, now, confirm.windows.pick(far))


def located(problem: Problem, theta: Floats, names: Sequence[str]) -> Stretches:
    """Where in a problem's windows something else acts: (trace, from, to) in s, by predictions over a tenth of one.

    It begins after the last good prediction ended, and is over where the look-back of the next good one begins. The
    span of the windows where no prediction is that short.
    """
    spans = stretches(problem.windows, problem.t, list(names))
    ahead = horizon_error(problem, theta, _AHEAD_S)
    if ahead is None:
        return spans
    size = np.mean((ahead.error / problem.sigma) ** 2, axis=1)
    begin, end = problem.t[ahead.begin], problem.t[ahead.end]
    trace = np.array(names)[np.searchsorted(problem.firsts, ahead.begin, side="right") - 1]
    out: list[tuple[str, float, float]] = []
    for name, a, b in spans:
        own = np.flatnonzero((begin >= a) & (begin <= b) & (trace == name))
        bad = size[own] > max(_WORST * size[own].max(initial=0.0), FAR)
        if not bad.any():
            out.append((name, a, b))
            continue
        first, last = int(np.argmax(bad)), len(bad) - 1 - int(np.argmax(bad[::-1]))
        since = float(end[own[first - 1]]) if first > 0 else a
        until = float(begin[own[last + 1]]) - LOOK_BACK_S if last + 1 < len(bad) else b
        out.append((name, since, max(until, float(end[own[first]]))))
    return tuple(out)


def push_faults(
    known: Problem, confirm: Problem, aside: tuple[Windows | None, Windows | None], theta: Floats, names: Sequence[str]
) -> list[RecordingFault]:
    """The finding: from when to when, and how many windows were set aside; `aside`: of those known and of *confirm*."""
    where: list[tuple[str, float, float]] = []
    windows, of = 0, len(known.windows) + len(confirm.windows)
    for problem, gone in zip((known, confirm), aside, strict=True):
        if gone is not None:
            where += located(problem.on(gone), theta, names)
            windows += len(gone)
    if not windows:
        return []
    where.sort(key=lambda span: (list(names).index(span[0]), span[1]))
    return [_push_fault(where, windows, of + (0 if aside[0] is None else len(aside[0])))]


def _push_fault(where: Sequence[tuple[str, float, float]], windows: int, of: int) -> RecordingFault:
    spans = [f"{a:.4g} to {b:.4g} s of {trace}" for trace, a, b in where]
    told = joined(spans if len(spans) <= 3 else [*spans[:3], f"{len(spans) - 3} more"])
    count = f"{windows} of {of} windows were set aside" if windows > 1 else f"1 of {of} windows was set aside"
    return RecordingFault(
        "push", "", float(sum(b - a for _, a, b in where)), "s",
        f"At {told} something acts that was not recorded (a push, a stop that was hit?); {count}.",
        "Record what acts there, or leave these times out with measured.masks.",
    )  # fmt: skip
