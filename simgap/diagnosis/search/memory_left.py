"""Whether what a fit leaves remembers itself: a trace of something that was not described, however small it is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import LAGS_ASKED, MEMORY_BY_CHANCE
from simgap.distributions import chi2


def memory_left(problem: Problem, found: Fit) -> bool:
    """Whether the misses of some channel correlate with themselves more than independent ones would by chance.

    Needs no size of the noise. Source: Ljung, Box (1978), Biometrika 65(2), of the pairs within windows.
    """
    misses = problem.residuals(found.theta, found.x0)
    at_most = float(chi2.isf(MEMORY_BY_CHANCE / misses.shape[1], LAGS_ASKED))
    return any(_portmanteau(misses[:, k], problem.rows) > at_most for k in range(misses.shape[1]))


def _portmanteau(miss: Floats, rows: Ints) -> float:
    """Sum over the lags of pairs times squared correlation: of independent misses chi^2, one for each lag."""
    total, size = 0.0, float(np.mean(miss**2))
    for lag in range(1, LAGS_ASKED + 1):
        products = [miss[a : b - lag] * miss[a + lag : b] for a, b in pairwise(rows)]
        pairs = np.concatenate(products)
        total += float(np.sum(pairs)) ** 2 / max(pairs.size * size**2, 1e-300)
    return total
