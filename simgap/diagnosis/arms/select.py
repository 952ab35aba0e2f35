"""Which columns explain an arm's torques: chosen joint by joint on data that they were not fitted to.

Forward selection by BIC on *choose* of coefficients fitted to *fit*, with the inertial parameters as declared and with
all their combinations free; the limit on the number of terms is each joint's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.fit import Solution, score, solve
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, Key, Part
from simgap.diagnosis.arms.terms import TERMS
from simgap.diagnosis.arms.thresholds import EXPECTED, SAME_DIRECTION
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN
from simgap.effects import effect


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
    found = []
    for given in (payload, (*inertial, *payload)):
        found.append(forward(keys, gram, right, judge, together, given, per_joint, most))
    declared, free = found
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
                if not physical(keys, solve(gram, right, trial, len(keys))):
                    continue
                value = _bic(gram, right, judge, together, trial)
                enough = AS_GOOD if keys[k].effect in EXPECTED else BIC_GAIN
                if bic - value > enough and (best is None or value < best[0]):
                    best = value, k
        if best is None:
            return Choice(active, bic, gains)
        gains[best[1]] = bic - best[0]
        bic, active = best[0], (*active, best[1])


def physical(keys: Sequence[Key], found: Solution) -> bool:
    """Whether every term keeps the limits of its effect, such as a friction that does not push."""
    return all(admissible(keys[k], float(found.theta[k])) for k in found.active)


def admissible(key: Key, value: float) -> bool:
    """Whether an effect's parameter may have that value; whatever is no term of a joint may."""
    if key.effect not in TERMS:
        return True
    (p,) = effect(key.effect).parameters
    return p.lower <= value <= p.upper


def _bic(gram: Floats, right: Floats, judge: Part, together: Floats, active: tuple[int, ...]) -> float:
    return score(judge, solve(gram, right, active, len(gram)).theta, len(active), together)


def _own_direction(gram: Floats, active: tuple[int, ...], k: int) -> bool:
    """Whether a column does something that the active ones together do not."""
    if gram[k, k] <= 0.0:
        return False
    own = np.array(active, dtype=np.int64)
    if not len(own):
        return True
    scale = np.sqrt(np.maximum(np.diag(gram)[own], 1e-300))
    inverse = np.linalg.pinv(gram[np.ix_(own, own)] / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    cross = gram[own, k] / scale
    return float(1.0 - cross @ inverse @ cross / gram[k, k]) > SAME_DIRECTION**2
