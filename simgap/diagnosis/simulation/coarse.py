"""A smaller problem for the search: block means of a densely sampled record, and a spread of its windows.

The search fits hundreds of sets of effects, and neither a rate far above the motion's nor hours of data change which
set wins; what it chooses is fitted and judged on every sample afterwards. A block mean keeps what the samples say
together: its noise is the samples' over the root of their number. Where the motion bends more within a block than the
mean's noise hides, the sample at its middle stands for it instead. Inputs are held at their mean over the block; blocks
are only so long that this moves no prediction of the declared model by more than a share of the noise.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.record import MIN_SAMPLES
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Memo, Problem, interval
from simgap.diagnosis.simulation.step_length import settled

SAMPLES_A_WINDOW = 200
"""Samples that a window keeps in the search."""
SEARCH_ROWS = 12_000
"""Samples of all windows that the search fits."""
JUDGED_ROWS = 40_000
"""Samples of all windows that choose among sets by what carries over."""
_BIAS = 0.2  # a block's mean may miss the motion at its middle by this share of the mean's noise, and inputs that are
# held at their means may move a prediction by this share of the noise


def coarse(problem: Problem, rows: int = SEARCH_ROWS, together: int = 1) -> Problem:
    """The problem that a search works on; the same one if it is small enough.

    Args:
        problem: every sample.
        rows: the most samples of all windows together.
        together: neighbouring windows that are kept or left out together (a prediction may be longer than a window).
    """
    lengths = np.diff(problem.rows)
    k = _odd(int(np.median(lengths)) // SAMPLES_A_WINDOW if len(lengths) else 1)
    while k > 1 and _moved(problem, k) > _BIAS:
        k = _odd(k // 2)
    thin = problem if k == 1 else settled(_blocks(problem, k))
    share = rows / max(thin.windows.samples, 1)
    if share >= 1.0:
        return thin
    group = np.arange(len(thin.windows)) // together
    count = max(1, int(share * (group[-1] + 1)))
    spread = np.linspace(0, group[-1], count).round().astype(np.int64)
    return thin.on(thin.windows.pick(np.isin(group, spread)))


def _odd(k: int) -> int:
    """So many samples in a block that one of them is its middle."""
    return max(k - (1 - k % 2), 1)


def _moved(problem: Problem, k: int) -> float:
    """RMS change over the noise of what the declared model predicts, where inputs are held at their means over k
    samples; that of the worst channel."""
    part, _ = problem.some()
    x0, theta, u = initial_states(part), problem.model.null, np.empty_like(problem.u)
    for a, b in itertools.pairwise(problem.edges.tolist()):
        means, starts = _means(problem.t[a:b], problem.u[a:b], k)
        u[a:b] = np.repeat(means, np.diff([*starts.tolist(), b - a]), axis=0)
    change = part.misses(theta, x0) - replace(part, u=u, memo=Memo()).misses(theta, x0)
    return float(np.sqrt(np.max(np.mean(np.square(change), axis=0), initial=0.0)))


def _means(t: Floats, u: Floats, k: int) -> tuple[Floats, Ints]:
    """Means over time of held inputs (n, m) from every k-th stamp to the next, (blocks, m), and where they begin."""
    at = np.arange(0, len(t), k)
    area = np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    means = u[at].copy()
    means[:-1] = np.diff(area[at], axis=0) / np.diff(t[at])[:, None]
    return means, at


def _bias(problem: Problem, k: int) -> float:
    """RMS of block mean minus motion at the middle, over the noise of one sample, of the worst channel.

    A second difference of block means, k samples apart, is k^2 times the curvature; the mean of a block is off by
    (k^2 - 1) / 24 times it. What noise alone would show is taken away.
    """
    worst = 0.0
    for channel, sigma in zip(problem.y.T, problem.sigma, strict=True):
        means = np.convolve(channel, np.full(k, 1.0 / k), "valid")
        bend = (means[2 * k :] - 2.0 * means[k:-k] + means[: -2 * k]) / sigma
        size = max(float(np.mean(bend**2)) - 6.0 / k, 0.0) if bend.size else 0.0
        worst = max(worst, np.sqrt(size) * (k * k - 1) / (24.0 * k * k))
    return worst


def _blocks(problem: Problem, k: int) -> Problem:
    """Blocks of k samples around every k-th one of each trace."""
    mean = _bias(problem, k) <= _BIAS / np.sqrt(k)
    parts = [_thinned(problem, a, b, k, mean) for a, b in itertools.pairwise(problem.edges.tolist())]
    firsts = np.cumsum([0, *(len(part[0]) for part in parts[:-1])])
    t, y, u, weight, used = (np.ascontiguousarray(np.concatenate(each)) for each in zip(*parts, strict=True))
    old, new = problem.firsts[problem.windows.trace], firsts[problem.windows.trace]
    start, stop = (new + -(-(edge - old) // k) for edge in (problem.windows.start, problem.windows.stop))
    windows = Windows(start, stop, problem.windows.trace).pick(stop - start >= MIN_SAMPLES)
    sigma, colour = problem.sigma / np.sqrt(k) if mean else problem.sigma, problem.colour
    if colour is not None:
        colour, spread = colour.of_blocks(k, mean)
        sigma = problem.sigma * spread
    return replace(
        problem, t=t, y=y, u=u, firsts=firsts, windows=windows, sigma=sigma, h_max=interval(t), memo=Memo(),
        used=used, weight=weight, colour=colour,
    )  # fmt: skip


def _thinned(problem: Problem, a: int, b: int, k: int, mean: bool) -> tuple[Floats, ...]:
    """Stamps, centred means of the readings (or the readings), means of the held inputs until the next stamp, and what
    each of these readings is worth (of a mean as much as one of its samples, else those between share its error), and
    which are compared: of a mean those without a lost reading."""
    t, y, u, weight, used = (x[a:b] for x in (problem.t, problem.y, problem.u, problem.weight, problem.used))
    held, at = _means(t, u, k)
    if not mean:
        return t[at], y[at], held, 1.0 / (1.0 + (1.0 / weight[at] - 1.0) / k), used[at]
    reach = np.minimum(np.minimum(at, len(t) - 1 - at), k // 2)  # the ends have less on one side
    total, lost = (np.concatenate([np.zeros((1, y.shape[1])), np.cumsum(x, axis=0)]) for x in (y, 1.0 - used))
    middle = (total[at + reach + 1] - total[at - reach]) / (2 * reach + 1)[:, None]
    kept = (lost[at + reach + 1] == lost[at - reach]).astype(np.float64)
    return t[at], middle, held, weight[at], kept
