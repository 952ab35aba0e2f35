"""Errors of a model on data that it was not fitted to: in windows, h ahead, and where they are.

E(h) is the causal error h ahead, F(h) what a perfect model would show with this noise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.record.folds import LOOK_BACK_SAMPLES, Windows, merged
from simgap.diagnosis.record.record import runs
from simgap.diagnosis.result import Concentrated, Judged, Stretches
from simgap.diagnosis.search.confidence import at_noise, chi2_dof
from simgap.diagnosis.search.fit import Fit, states_fitted
from simgap.diagnosis.simulation.noise_law import are_gross, limited
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import foreseen_variance, state_columns, state_steps
from simgap.diagnosis.thresholds import A_FEW, MOST
from simgap.diagnosis.verdict.score import Errors

_LATER = 0.1  # of the horizon, by which a prediction may end later where a channel is read more seldom


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Error of one parameter vector on windows that it was not fitted to.

    Attributes:
        states: (w, nx) initial states, refitted; rmse: (k,) with them; ratio: RMSE over noise, all channels together.
        chi2: with them; free: compared numbers less what the initial states took.
        heard: (k,) 1 for channels that are fitted.
        horizon: the causal error ahead; None if it was not asked for, or no stretch is long enough.
        errors: what it is scored by: the errors ahead, of the windows where there are none.
        stray: readings that are gross errors: `chi2` limits what one of them counts.
    """

    states: Floats
    rmse: Floats
    ratio: float
    chi2: float
    free: int
    heard: Floats
    horizon: HorizonError | None
    errors: Errors
    stray: int = 0

    @property
    def at_noise(self) -> bool:
        """Whether the error is no more than noise, as far as so few numbers can tell."""
        return at_noise(self.chi2, self.free)


def judge(held: Problem, theta: Floats, horizon_s: float) -> HeldOut:
    """Refit only the initial states (w, nx) of held-out windows at theta (q,), and predict ahead causally."""
    held = replace(held, usual=None)
    at = states_fitted(held, theta)
    plain = held.residuals(theta, at.x0)
    noise = np.ones(len(held.sigma))
    loss = limited(plain, noise)
    count, chi2 = held.size, float(np.sum(loss**2))
    unbiased = math.sqrt(max(1.0 - held.taken / count, 0.1))  # the initial states took some degrees of freedom
    misses = held.misses(theta, at.x0)
    rmse = np.sqrt(np.sum(misses**2, axis=0) / held.compared) * held.sigma / unbiased
    ratio = math.sqrt(float(np.sum(plain**2)) / count) / unbiased
    free = max(round(count - held.taken), 1)
    ahead = horizon_error(held, theta, horizon_s)
    by_window = Errors(misses[:, held.heard > 0.0], np.repeat(np.arange(len(held.windows)), np.diff(held.rows)))
    errors = by_window if ahead is None else _blocks(held, ahead)
    return HeldOut(at.x0, rmse, ratio, chi2, free, held.heard, ahead, errors, int(np.sum(are_gross(loss, noise))))


def errors_ahead(held: Problem, theta: Floats, horizon_s: float) -> Errors:
    """What `judge` scores a model by, and nothing else."""
    held = replace(held, usual=None)
    ahead = horizon_error(held, theta, horizon_s)
    return judge(held, theta, 0.0).errors if ahead is None else _blocks(held, ahead)


def _blocks(held: Problem, ahead: HorizonError) -> Errors:
    """Errors ahead in blocks so long that none reaches past the next one."""
    trace = np.searchsorted(held.firsts, ahead.begin, side="right") - 1
    since, ends = held.t[ahead.begin] - held.t[held.firsts[trace]], held.t[ahead.end] - held.t[ahead.begin]
    length = float(np.max(ends)) + look_back(held)
    place = np.stack([trace, since // length], axis=1)
    errors = (ahead.error / held.sigma)[:, held.heard > 0.0]
    return Errors(errors, np.unique(place, axis=0, return_inverse=True)[1].ravel())


def judged(problem: Problem, at: Fit, held: HeldOut, horizon_s: float) -> Judged:
    """The figures of one model as they are reported."""
    ahead = {} if held.horizon is None else by_channel(problem, held.horizon.rmse)
    return Judged(by_channel(problem, held.rmse), horizon_s, ahead, chi2_dof(problem, at), held.ratio)


def noise_floor(held: Problem, seen: HeldOut, horizon_s: float) -> Judged:
    """The figures of a perfect model with this noise; `seen`: the error of the model whose prediction it is."""
    ahead = {} if seen.horizon is None else by_channel(held, seen.horizon.floor)
    return Judged(by_channel(held, held.sigma), horizon_s, ahead, 1.0, 1.0)


def by_channel(problem: Problem, values: Floats) -> dict[str, float]:
    """Numbers (k,) of the measured channels, by name."""
    return dict(zip(problem.model.measured, values.tolist(), strict=True))


def excess_share(before: HeldOut, after: HeldOut, sigma: Floats) -> float:
    """Excess of E(h) over F(h), after over before, all fitted channels in units of their noise; 1 if there was none.

    Of the windows where no stretch is long enough for a prediction.
    """
    floor = None if after.horizon is None else after.horizon.floor

    def excess(held: HeldOut) -> float:
        if held.horizon is None or floor is None:
            return math.sqrt(max(0.0, held.ratio**2 - 1.0))
        over = np.maximum(held.horizon.rmse**2 - floor**2, 0.0) / sigma**2
        return float(np.sqrt(np.mean(over[held.heard > 0.0])))

    was = excess(before)
    return excess(after) / was if was > 0.0 else 1.0


@dataclass(frozen=True, eq=False)
class HorizonError:
    """Predictions h ahead.

    Attributes:
        error: (n, k) of each prediction; begin, end: (n,) samples where it began and where it was judged.
        expected: makes `floor`.
    """

    error: Floats
    begin: Ints
    end: Ints
    expected: Callable[[], Floats]

    @cached_property
    def rmse(self) -> Floats:
        """E(h), (k,)."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @cached_property
    def floor(self) -> Floats:
        """F(h), (k,)."""
        return self.expected()


def horizon_error(problem: Problem, theta: Floats, horizon: float) -> HorizonError | None:
    """Predict `horizon` seconds ahead at theta (q,) from many instants of the problem's windows.

    At each instant the state is estimated from the samples of the last `Problem.brief` seconds alone (at least
    `LOOK_BACK_SAMPLES`), then the model runs on the recorded input; E is the RMS error at the end. F adds to the noise
    of the sample at the end what the noise of the look-back does to the state estimate, by the model's linearisation.
    Returns None if no stretch is long enough, or none is asked for.
    """
    if horizon <= 0.0:
        return None
    base, middle, end, trace = _instants(problem, horizon)
    if not len(base):
        return None
    at = problem.on(Windows(base, middle, trace))
    start = states_fitted(at, theta).x0
    whole = problem.on(Windows(base, end, trace))
    error = whole.misses(theta, start)[whole.rows[1:] - 1] * problem.sigma
    return HorizonError(error, middle - 1, end - 1, partial(_floor, at, whole, theta, start))


def look_back(problem: Problem) -> float:
    """From how long before a prediction its state is estimated, s: no longer than a window, at least some samples."""
    return max(problem.brief, LOOK_BACK_SAMPLES * problem.spacing)


def _instants(problem: Problem, horizon: float) -> Ints:
    """Look-back from, instant (exclusive end of the look-back), end (exclusive) and the trace, samples (4, n).

    A prediction ends at a sample at which every channel is a measurement: what is none would count as no error.
    """
    rows: list[tuple[int, int, int, int]] = []
    t, back = problem.t, look_back(problem)
    read = np.flatnonzero(np.all((problem.used > 0.0) | (problem.heard == 0.0), axis=1))
    for a, b, trace in merged(problem.windows):
        k = a
        while True:
            middle = max(int(np.searchsorted(t[a:b], t[k] + back)) + a, k + LOOK_BACK_SAMPLES)
            if middle >= b:
                break
            aim = t[middle - 1] + horizon * (1 - 1e-9)
            end = int(np.searchsorted(t[a:b], aim)) + a
            if end >= b:
                break
            known = read[np.searchsorted(read, end) :][:1]
            if known.size and known[0] < b and t[known[0]] <= aim + _LATER * horizon:
                rows.append((k, middle, int(known[0]) + 1, trace))
            k = max(int(np.searchsorted(t[a:b], t[k] + 0.25 * max(horizon, back))) + a, k + 1)
    return np.ascontiguousarray(np.array(rows, dtype=np.int64).reshape(-1, 4).T)


def _floor(at: Problem, whole: Problem, theta: Floats, start: Floats) -> Floats:
    """F(h) from the covariance of the look-back's state estimate, carried to the end."""
    steps = state_steps(start)
    back = state_columns(at, theta, start, steps)[1]
    ahead = state_columns(whole, theta, start, steps, Problem.misses)[1][:, whole.rows[1:] - 1]
    pieces = enumerate(itertools.pairwise(at.rows))
    variance = [foreseen_variance(back[:, a:b], ahead[:, w]) for w, (a, b) in pieces]
    return np.asarray(np.sqrt(np.mean(variance, axis=0)) * at.sigma)


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
    size = [np.mean((h.error / confirm.sigma) ** 2, axis=1) for h in (before, after)]
    largest = np.sort(size[1])[::-1]
    carried = np.cumsum(largest) / np.sum(largest)
    count = int(np.searchsorted(carried, MOST)) + 1
    if count > A_FEW * len(largest):
        return None
    # of each model its own worst predictions: to leave out where one misses would flatter it
    worst = [np.isin(np.arange(len(s)), np.argsort(-s)[:count]) for s in size]
    rest = [~_touched(h, bad) for h, bad in zip((before, after), worst, strict=True)]
    if not all(r.any() for r in rest):
        return None
    squares = [np.mean(h.error[r] ** 2, axis=0) for h, r in zip((before, after), rest, strict=True)]
    was, now = (float(np.mean(np.maximum(s - after.floor**2, 0.0) / confirm.sigma**2)) for s in squares)
    share = math.sqrt(now / was) if was > 0.0 else 1.0
    medians = (by_channel(confirm, np.median(np.abs(h.error), axis=0)) for h in (before, after))
    return Concentrated(_places(confirm, names, after, worst[1]), float(carried[count - 1]), share, *medians)


def _touched(h: HorizonError, bad: Bools) -> Bools:
    """Predictions that overlap a bad one."""
    spans = zip(h.begin[bad], h.end[bad], strict=True)
    return np.any([(h.begin <= b) & (h.end >= a) for a, b in spans], axis=0)


def _places(confirm: Problem, names: Sequence[str], after: HorizonError, bad: Bools) -> Stretches:
    """What most of the bad predictions around have in common, as stretches of time."""
    begun, ended = (np.bincount(at, minlength=len(confirm.t) + 1) for at in (after.begin[bad], after.end[bad] + 1))
    cover = np.cumsum(begun - ended)[:-1]
    out = []
    for a, b in runs(cover != 0.0):
        core = a + np.flatnonzero(cover[a:b] > 0.5 * cover[a:b].max())
        trace = int(np.searchsorted(confirm.firsts, a, side="right")) - 1
        out.append((names[trace], float(confirm.t[core[0]]), float(confirm.t[core[-1]])))
    return tuple(out)
