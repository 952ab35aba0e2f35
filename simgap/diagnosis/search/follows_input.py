"""Does what a model leaves follow the input? A sensor's noise does not; what a plant does that the model lacks does.

The residual is regressed on the inputs of the last samples and on their squares with their sign, and the regression's
F compared with chance: the test of independence between residuals and past inputs (Ljung (1999), System Identification,
sec. 16.6), here of a residual that is white already, so that chance needs no correction.
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import BY_CHANCE
from simgap.distributions import fisher

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
