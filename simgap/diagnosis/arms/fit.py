"""Weighted least squares of an arm's torques, what is independent among its rows, and honest intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.problem import Part


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients of the active columns: (p,), 0 elsewhere."""

    active: tuple[int, ...]
    theta: Floats


def solve(gram: Floats, right: Floats, active: Sequence[int], size: int) -> Solution:
    """Least squares over the active columns alone; directions that the data do not show stay 0."""
    theta = np.zeros(size)
    if len(active):
        own = np.array(active)
        g = gram[np.ix_(own, own)]
        scale = np.sqrt(np.maximum(np.diag(g), 1e-300))
        inverse = np.linalg.pinv(g / np.outer(scale, scale), rcond=1e-10, hermitian=True)
        theta[own] = inverse @ (right[own] / scale) / scale
    return Solution(tuple(active), theta)


def residual(part: Part, theta: Floats) -> Floats:
    """(R, n) measured torque less the model's."""
    return part.y - part.x @ theta


def spread(part: Part, theta: Floats) -> Floats:
    """(n,) RMS of what is left of each joint while it moves."""
    left = residual(part, theta)
    return np.sqrt((part.live * left**2).sum(axis=0) / np.maximum(part.live.sum(axis=0), 1.0))


def correlation_rows(part: Part, theta: Floats) -> Floats:
    """(n,) rows that count as one: the integrated autocorrelation of what is left, up to its first zero.

    Source: Geyer (1992), Statistical Science 7(4), initial positive sequence.
    """
    left = residual(part, theta) * part.live
    out = np.ones(left.shape[1])
    for j in range(left.shape[1]):
        r = left[:, j]
        power = float(r @ r)
        total = 1.0
        for lag in range(1, len(r) // 4):
            same = part.trace[lag:] == part.trace[:-lag]
            share = float((r[lag:] * r[:-lag])[same].sum()) / max(power, 1e-300)
            if share <= 0.0:
                break
            total += 2.0 * share
        out[j] = total
    return out


def score(part: Part, theta: Floats, count: int, together: Floats) -> float:
    """BIC of coefficients on a part: rows of a joint count as N / `together` independent ones."""
    left, rows = residual(part, theta), part.live.sum(axis=0)
    independent = np.maximum(rows / together, 1.0)
    mean = (part.live * left**2).sum(axis=0) / np.maximum(rows, 1.0)
    return float(independent @ np.log(np.maximum(mean, 1e-300)) + count * np.log(independent.sum()))


def standard_errors(part: Part, solution: Solution, weights: Floats, together: Floats) -> Floats:
    """(p,) standard errors that hold for residuals which are correlated in time and among joints.

    Newey, West (1987), Econometrica 55(3): the scores' autocovariances with Bartlett's weights, to three times the
    longest correlation.
    """
    own = np.array(solution.active, dtype=np.int64)
    out = np.zeros(len(solution.theta))
    if not len(own):
        return out
    w = part.live * weights**2
    x = part.x[:, :, own]
    scores = np.einsum("rjp,rj->rp", x, w * residual(part, solution.theta))
    gram = np.einsum("rjp,rjq->pq", x * w[:, :, None], x, optimize=True)
    reach = int(min(3 * together.max(), len(scores) / 8))
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        same = (part.trace[lag:] == part.trace[:-lag])[:, None]
        cross = (scores[lag:] * same).T @ scores[:-lag]
        middle += (1.0 - lag / (reach + 1)) * (cross + cross.T)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)
    out[own] = np.sqrt(np.maximum(np.diag(inverse @ middle @ inverse), 0.0))
    return out
