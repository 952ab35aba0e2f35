"""Is what a model leaves chance? A sensor's noise does not follow the input, and independent misses do not remember.

The residual is regressed on the inputs of the last samples and on their squares with their sign, and the regression's
F compared with chance: the test of independence between residuals and past inputs (Ljung (1999), System Identification,
sec. 16.6), here of a residual that is white already, so that chance needs no correction.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import BY_CHANCE
from simgap.statistics import chi2, fisher

_ASKED = 20  # lags whose correlations are asked together
_LAGS = 1 + 2 * np.arange(12)  # samples; a command of the same one may be fed back from the reading, noise and all


def follows_input(problem: Problem, white: Floats) -> bool:
    """Whether any channel of a white residual (n, k) follows the inputs by more than chance."""
    past = _past(problem)
    past = past - past.mean(axis=0)
    rank = int(np.linalg.matrix_rank(past))
    free = len(past) - rank - 1
    if rank == 0 or free < 1:
        return False
    centred = white - white.mean(axis=0)
    told = past @ np.linalg.lstsq(past, centred, rcond=1e-10)[0]
    explained, whole = np.sum(told**2, axis=0), np.sum(centred**2, axis=0)
    ratio = (explained / rank) / np.maximum((whole - explained) / free, 1e-300)
    return bool(np.any(ratio > fisher.ppf(1.0 - BY_CHANCE, rank, free)))


def _past(problem: Problem) -> Floats:
    """Inputs of the last samples of each window and their squares with their sign: (n, 2 nu lags)."""
    scale = np.maximum(np.abs(problem.u).max(axis=0), 1e-300)
    blocks = []
    for begin, end in zip(problem.rows[:-1].tolist(), problem.rows[1:].tolist(), strict=True):
        at = problem.samples[begin:end]
        u = problem.u[np.maximum(at[:, None] - _LAGS, at[0])] / scale  # (rows, lags, nu)
        blocks.append(np.concatenate([u, np.abs(u) * u], axis=2).reshape(end - begin, -1))
    return np.concatenate(blocks)


def memory_left(problem: Problem, found: Fit) -> bool:
    """Whether the misses of some channel correlate with themselves more than independent ones would by chance.

    Needs no size of the noise. Source: Ljung, Box (1978), Biometrika 65(2), of the pairs within windows.
    """
    misses = problem.residuals(found.theta, found.x0)
    at_most = float(chi2.isf(BY_CHANCE / misses.shape[1], _ASKED))
    return any(_portmanteau(misses[:, k], problem.rows) > at_most for k in range(misses.shape[1]))


def _portmanteau(miss: Floats, rows: Ints) -> float:
    """Sum over the lags of pairs times squared correlation: of independent misses chi^2, one for each lag."""
    total, size = 0.0, float(np.mean(miss**2))
    for lag in range(1, _ASKED + 1):
        products = [miss[a : b - lag] * miss[a + lag : b] for a, b in pairwise(rows)]
        pairs = np.concatenate(products)
        total += float(np.sum(pairs)) ** 2 / max(pairs.size * size**2, 1e-300)
    return total
