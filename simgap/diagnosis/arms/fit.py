"""Weighted least squares of an arm's torques with honest intervals, and the columns that explain them.

Columns are chosen joint by joint on data that they were not fitted to: forward selection by BIC on *choose* of
coefficients fitted to *fit*, with the inertial parameters as declared and with all their combinations free; the limit
on the number of terms is each joint's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, TERMS, Key, Part
from simgap.diagnosis.record.noise import samples_as_one
from simgap.diagnosis.simulation.sensitivity import inverted
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN
from simgap.effects import effect

_OWN = 1e-3  # a term of which less (of its norm) is not what others do is not sought beside them
EXPECTED = ("viscous_friction", "coulomb_friction")
"""What every drive with a gear has."""


def solve(gram: Floats, right: Floats, active: Sequence[int]) -> Floats:
    """Least squares over the active columns alone, (p,); directions that the data do not show stay 0."""
    theta, own = np.zeros(len(right)), np.array(active, dtype=np.int64)
    if len(own):
        theta[own] = inverted(gram[np.ix_(own, own)]) @ right[own]
    return theta


def residual(part: Part, theta: Floats) -> Floats:
    """(R, n) measured torque less the model's."""
    return part.y - part.x @ theta


def spread(part: Part, theta: Floats) -> Floats:
    """(n,) RMS of what is left of each joint while it moves."""
    left = residual(part, theta)
    return np.sqrt((part.live * left**2).sum(axis=0) / np.maximum(part.live.sum(axis=0), 1.0))


def correlation_rows(part: Part, theta: Floats) -> Floats:
    """(n,) rows that count as one, by what is left of each joint."""
    left = residual(part, theta) * part.live
    stretches = np.split(left, np.flatnonzero(np.diff(part.trace)) + 1)
    joints = range(left.shape[1])
    return np.array([samples_as_one([own[:, [j]] for own in stretches], max(len(left) // 4, 1)) for j in joints])


def standard_errors(part: Part, theta: Floats, active: Sequence[int], weights: Floats, together: Floats) -> Floats:
    """(p,) standard errors that hold for residuals which are correlated in time and among joints.

    Newey, West (1987), Econometrica 55(3): the scores' autocovariances with Bartlett's weights, to three times the
    longest correlation.
    """
    own, out = np.array(active, dtype=np.int64), np.zeros(len(theta))
    if not len(own):
        return out
    w = part.live * weights**2
    x = part.x[:, :, own]
    scores = np.einsum("rjp,rj->rp", x, w * residual(part, theta))
    gram = np.einsum("rjp,rjq->pq", x * w[:, :, None], x, optimize=True)
    reach = int(min(3 * together.max(), len(scores) / 8))
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        same = (part.trace[lag:] == part.trace[:-lag])[:, None]
        cross = (scores[lag:] * same).T @ scores[:-lag]
        middle += (1.0 - lag / (reach + 1)) * (cross + cross.T)
    inverse = inverted(gram)
    out[own] = np.sqrt(np.maximum(np.diag(inverse @ middle @ inverse), 0.0))
    return out


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen: columns, BIC on *choose*, and the gain of each term when it was taken in."""

    active: tuple[int, ...]
    bic: float
    gains: dict[int, float]


def choose(
    keys: Sequence[Key], fit: Part, judge: Part, weights: Floats, together: Floats, most: int, joints: int
) -> Choice:
    """The better of two selections: inertial parameters as declared, and free."""
    gram, right = fit.grams(weights)
    inertial = tuple(k for k, key in enumerate(keys) if key.effect == INERTIAL)
    payload = tuple(k for k, key in enumerate(keys) if key.effect == PAYLOAD)
    first = len(inertial)
    per_joint = [range(first + j * len(TERMS), first + (j + 1) * len(TERMS)) for j in range(joints)]
    declared, free = (
        forward(keys, gram, right, judge, together, given, per_joint, most)
        for given in (payload, (*inertial, *payload))
    )
    return free if free.bic < declared.bic - BIC_GAIN else declared


def forward(
    keys: Sequence[Key], gram: Floats, right: Floats, judge: Part, together: Floats, given: tuple[int, ...],
    per_joint: Sequence[Sequence[int]], most: int,
) -> Choice:  # fmt: skip
    """Terms join the given columns one by one, the one that lowers BIC on *choose* most first."""
    active, gains = given, dict[int, float]()
    bic = _bic(gram, right, judge, together, active)
    while True:
        best: tuple[float, int] | None = None
        for own in per_joint:
            if sum(k in active for k in own) >= most:
                continue
            for k in own:
                if k in active or not _own_direction(gram, active, k):
                    continue
                trial = (*active, k)
                theta = solve(gram, right, trial)
                if not all(admissible(keys[i], float(theta[i])) for i in trial):
                    continue
                value = _bic(gram, right, judge, together, trial)
                enough = AS_GOOD if keys[k].effect in EXPECTED else BIC_GAIN
                if bic - value > enough and (best is None or value < best[0]):
                    best = value, k
        if best is None:
            return Choice(active, bic, gains)
        gains[best[1]] = bic - best[0]
        bic, active = best[0], (*active, best[1])


def admissible(key: Key, value: float) -> bool:
    """Whether an effect's parameter may have that value, such as a friction that does not push; no limit for others."""
    if key.effect not in TERMS:
        return True
    (p,) = effect(key.effect).parameters
    return p.lower <= value <= p.upper


def _bic(gram: Floats, right: Floats, judge: Part, together: Floats, active: tuple[int, ...]) -> float:
    """Of coefficients on a part that they were not fitted to: rows count as N / `together` independent ones."""
    left, rows = residual(judge, solve(gram, right, active)), judge.live.sum(axis=0)
    independent = np.maximum(rows / together, 1.0)
    mean = (judge.live * left**2).sum(axis=0) / np.maximum(rows, 1.0)
    return float(independent @ np.log(np.maximum(mean, 1e-300)) + len(active) * np.log(independent.sum()))


def _own_direction(gram: Floats, active: tuple[int, ...], k: int) -> bool:
    """Whether a column does something that the active ones together do not."""
    if gram[k, k] <= 0.0:
        return False
    own = np.array(active, dtype=np.int64)
    if not len(own):
        return True
    cross = gram[own, k]
    return float(1.0 - cross @ inverted(gram[np.ix_(own, own)]) @ cross / gram[k, k]) > _OWN**2
