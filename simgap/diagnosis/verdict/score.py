"""How well a model predicts what it was not fitted to: the log density of its errors, and its standard error.

The density is a Student's t, as real errors have heavy tails: a few pushes carry a sum of squares and weigh little
here. Its scale comes from other parts of the data than those scored. Errors of one block of time depend on each other,
so that blocks, not errors, are what the standard error is over.
Sources: Vehtari, Gelman, Gabry (2017), Stat. Comput. 27; Bergmeir, Hyndman, Koo (2018), Comput. Stat. Data Anal. 120
(blocks in time); Lange, Little, Taylor (1989), J. Am. Stat. Assoc. 84 (t errors).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.simulation.gross_errors import usual_size
from simgap.diagnosis.thresholds import CONFIDENCE, MATTERS, TAILS
from simgap.distributions import student

_PARTS = 10  # the data are scored by so many parts, each under the scale of the others


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of predictions, (n, k) in units of the noise, and the block that each is of, (n,)."""

    size: Floats
    block: Ints

    @staticmethod
    def joined(parts: Sequence[Errors]) -> Errors:
        """Errors of several folds, with blocks of their own."""
        first = np.cumsum([0, *(int(p.block.max(initial=-1)) + 1 for p in parts)])
        blocks = [p.block + f for p, f in zip(parts, first, strict=False)]
        return Errors(np.concatenate([p.size for p in parts]), np.concatenate(blocks))

    def density(self) -> Floats:
        """Mean log density of a number in each block, (b,)."""
        kept, at = np.unique(self.block, return_inverse=True)
        part = at * _PARTS // len(kept)
        logs = np.full(self.size.shape, -np.inf)
        for p in np.unique(part):
            own = part == p
            if not own.all():
                scale = usual_size(self.size[~own])
                logs[own] = student.logpdf(self.size[own] / scale, TAILS) - np.log(scale)
        return np.bincount(at, logs.mean(axis=1)) / np.bincount(at)


@dataclass(frozen=True)
class Gain:
    """What one model predicts better than another: mean gain of log density a number, and what it is sure by.

    Attributes:
        nats: the mean over blocks; half: half its 95 % interval, by the spread of the blocks.
    """

    nats: float
    half: float

    @property
    def share(self) -> tuple[float, float, float]:
        """The share of the error's scale that is taken away, and the ends of its 95 % interval."""
        low, high = self.nats - self.half, self.nats + self.half
        middle, low, high = (1.0 - math.exp(-min(max(x, -50.0), 50.0)) for x in (self.nats, low, high))
        return middle, low, high

    @property
    def matters(self) -> bool:
        """Whether it is of a size that matters."""
        return self.share[0] >= MATTERS

    @property
    def sure(self) -> bool:
        """Whether it is of a size that matters, and surely above zero."""
        return self.surely_above(Gain(0.0, 0.0))

    def surely_above(self, other: Gain) -> bool:
        """Whether it is above another that was not measured on the same blocks, surely and by a size that matters."""
        more = Gain(self.nats - other.nats, math.hypot(self.half, other.half))
        return more.matters and more.nats > more.half


def gained(before: Floats, after: Floats) -> Gain:
    """What the second predicts better, by the densities (b,) of both in each block; of one block nothing is sure."""
    if len(before) < 2 or not np.all(np.isfinite(before) & np.isfinite(after)):
        return Gain(0.0, math.inf)
    each, n = after - before, len(before)
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, n - 1)) * float(np.std(each, ddof=1)) / math.sqrt(n)
    return Gain(float(np.mean(each)), half)
