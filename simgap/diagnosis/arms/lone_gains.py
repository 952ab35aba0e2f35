"""Gains of single drives without a known weight: what several joints feel of the declared bodies ties them together.

With bodies as declared, a drive whose torque is g times what the bodies ask for has one column more, that torque. Where
this explains *choose* better than other bodies do, with fewer numbers, the gain is named. All gains and all masses off
by one factor move an arm alike, so that such a gain is relative to the declared masses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.fit import solve
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, Key, Part
from simgap.diagnosis.arms.select import forward
from simgap.diagnosis.arms.terms import TERMS
from simgap.diagnosis.thresholds import BIC_GAIN, MOST

GAIN = "input_gain"
SAID = (
    "The gains are relative to the declared masses: if all of these were off by one factor, other gains would do; a "
    "payload of known mass tells (measured.payloads, mass)."
)


def lone_gains(
    keys: Sequence[Key], inputs: Sequence[str], fit: Part, judge: Part, weights: Floats, together: Floats, most: int,
    bic: float,
) -> Floats | None:  # fmt: skip
    """(n,) g of each drive, declared over true, 1 where it is as declared; None if no gain explains *choose* better.

    Args:
        bic: of what was chosen without gains.
    """
    n, size = len(inputs), len(keys)
    wider = [*keys, *(Key(GAIN, name, "ratio") for name in inputs)]
    fitted, judged = (_with_bodies(part) for part in (fit, judge))
    first = sum(key.effect == INERTIAL for key in keys)
    given = tuple(k for k, key in enumerate(keys) if key.effect == PAYLOAD)
    own = [(*range(first + j * len(TERMS), first + (j + 1) * len(TERMS)), size + j) for j in range(n)]
    gram, right = fitted.grams(weights)
    chosen = forward(wider, gram, right, judged, together, given, own, most)
    g = 1.0 + solve(gram, right, chosen.active, len(wider)).theta[size:]
    off = int(np.sum(g != 1.0))
    if chosen.bic >= bic - BIC_GAIN or not 0 < off <= MOST * n or not np.all(g > 0.0):
        return None
    return np.asarray(g)


def _with_bodies(part: Part) -> Part:
    """The rows with a column for each drive: the torque that the declared bodies ask for there."""
    n = part.y.shape[1]
    columns = np.zeros((*part.y.shape, n))
    for j in range(n):
        columns[:, j, j] = (part.torque - part.y)[:, j]
    return replace(part, x=np.concatenate([part.x, columns], axis=2))
