"""A law of the misses with gross errors: what one reading, or a push, does to a fit is limited.

A miss is normal of the usual size or, a thousandth as likely at zero, anything at all. Beyond 3.7 times the usual size
the second is likelier: such a reading weighs nothing, and neither a model that comes a little nearer to it nor one that
goes further away is better for it. Sources: Tukey (1960), in Contributions to Probability and
Statistics, 448; Huber, Ronchetti (2009), Robust Statistics, sec. 4.5; Lange, Little, Taylor (1989), J. Am. Stat. Assoc.
84 (the usual size, by the scale of Student's t).
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.thresholds import SELDOM, TAILS

LIMIT = float(np.sqrt(-2.0 * np.log(SELDOM)))
"""Beyond so many usual sizes a miss is rather a gross error."""


def limited(residual: Floats, spread: Floats) -> Floats:
    """Residuals whose squares add up to the loss under the law: small ones stay as they are, none exceeds 3.7 spreads.

    Gauss-Newton steps on them are those of iteratively reweighted least squares: (n, k), (k,) -> (n, k).
    """
    half = -0.5 * np.square(residual / spread)
    return np.asarray(np.copysign(spread * np.sqrt(-2.0 * np.log1p(np.expm1(half) / (1.0 + SELDOM))), residual))


def are_gross(loss: Floats, spread: Floats) -> Bools:
    """Which limited residuals (n, k) stand for gross errors: their loss at the limit, both laws equally likely."""
    return np.asarray(np.square(loss / spread) > -2.0 * np.log1p((SELDOM - 1.0) / (1.0 + SELDOM)))


def usual_size(misses: Floats, used: Floats) -> Floats:
    """Scale of Student's t by maximum likelihood, (n, k) -> (k,); used: (n, k) 1 for misses that are ones."""
    return np.array([_scale(own[kept > 0.0]) for own, kept in zip(misses.T, used.T, strict=True)])


def _scale(misses: Floats) -> float:
    if not misses.size:
        return 0.0
    s = 1.4826 * float(np.median(np.abs(misses))) + 1e-9
    for _ in range(20):
        s = float(np.sqrt(np.mean((TAILS + 1.0) / (TAILS + (misses / s) ** 2) * misses**2))) + 1e-12
    return s
