"""The causal error h ahead, E(h), and what a perfect model would show with this noise, F(h)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.folds import LOOK_BACK_SAMPLES, Windows, joined
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import state_steps

_LATER = 0.1  # of the horizon, by which a prediction may end later where a channel is read more seldom


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
    Returns None if no stretch is long enough.
    """
    base, middle, end = _instants(problem, horizon)
    if not len(base):
        return None
    first = problem.firsts[np.searchsorted(problem.firsts, base, side="right") - 1]
    at = problem.on(Windows(base, middle, first, np.zeros_like(base)))
    start = fit(at, theta, initial_states(at), [], {}).x0
    whole = problem.on(Windows(base, end, first, at.windows.trace))
    error = whole.misses(theta, start)[whole.rows[1:] - 1] * problem.sigma
    return HorizonError(error, middle - 1, end - 1, partial(_floor, at, whole, theta, start))


def look_back(problem: Problem) -> float:
    """From how long before a prediction its state is estimated, s: no longer than a window, at least some samples."""
    return max(problem.brief, LOOK_BACK_SAMPLES * problem.spacing)


def _instants(problem: Problem, horizon: float) -> tuple[Ints, Ints, Ints]:
    """Look-back from, instant (exclusive end of the look-back), and end (exclusive) in samples.

    A prediction ends at a sample at which every channel is a measurement: what is none would count as no error.
    """
    rows: list[tuple[int, int, int]] = []
    t, back = problem.t, look_back(problem)
    read = np.flatnonzero(np.all((problem.used > 0.0) | (problem.heard == 0.0), axis=1))
    whole = joined(problem.windows)
    for a, b in zip(whole.start.tolist(), whole.stop.tolist(), strict=True):
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
                rows.append((k, middle, int(known[0]) + 1))
            k = max(int(np.searchsorted(t[a:b], t[k] + 0.25 * max(horizon, back))) + a, k + 1)
    table = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy()


def _floor(at: Problem, whole: Problem, theta: Floats, start: Floats) -> Floats:
    """F(h) from the covariance of the look-back's state estimate, carried to the end."""
    steps, k = state_steps(start), at.y.shape[1]
    back = np.empty((int(at.rows[-1]), k, start.shape[1]))
    ahead = np.empty((len(start), k, start.shape[1]))
    for i, step in enumerate(steps):
        shift = np.zeros(start.shape[1])
        shift[i] = step
        back[:, :, i] = (at.residuals(theta, start - shift) - at.residuals(theta, start + shift)) / (2 * step)
        low, high = whole.misses(theta, start - shift), whole.misses(theta, start + shift)
        ahead[:, :, i] = ((low - high) / (2 * step))[whole.rows[1:] - 1]
    variance = np.ones((len(start), k))
    for w in range(len(start)):
        a = back[at.rows[w] : at.rows[w + 1]].reshape(-1, start.shape[1])
        covariance = np.linalg.pinv(a.T @ a, rcond=1e-12)
        variance[w] += np.einsum("ki,ij,kj->k", ahead[w], covariance, ahead[w])
    return np.asarray(np.sqrt(np.mean(variance, axis=0)) * at.sigma)
