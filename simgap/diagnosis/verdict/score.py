"""How well a model predicts what it was not fitted to: the log density of its errors, and its standard error.

The density is a Student's t, as real errors have heavy tails, mixed with gross errors of any size: what nobody
predicts, a push, weighs much alike for every model, however well each predicts the rest. Scale and share come from
other parts of the data than those scored. Errors of one block of time depend on each other, so that blocks, not errors,
are what the standard error is over.
Sources: Vehtari, Gelman, Gabry (2017), Stat. Comput. 27; Bergmeir, Hyndman, Koo (2018), Comput. Stat. Data Anal. 120
(blocks in time); Lange, Little, Taylor (1989), J. Am. Stat. Assoc. 84 (t errors); Tukey (1960), in Contributions to
Probability and Statistics, 448 (gross errors).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.thresholds import CONFIDENCE, MATTERS, MOST, SELDOM, TAILS
from simgap.statistics import student

_PARTS = 10  # the data are scored by so many parts, each under the scale of the others
_DECADES = 6.0  # a gross error is as likely of each decade of size, so many above the noise
_SHARE = 0.1  # of gross errors, where their estimate begins


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
        return np.asarray(self.by_channel().mean(axis=1))

    def by_channel(self) -> Floats:
        """The same of each channel, (b, k); one part alone is scored by the law of its own errors."""
        kept, at = np.unique(self.block, return_inverse=True)
        part = at * _PARTS // len(kept)
        logs = np.empty(self.size.shape)
        for p in np.unique(part):
            own = part == p
            logs[own] = _log_density(self.size[own], self.size if own.all() else self.size[~own])
        return np.stack([np.bincount(at, own) for own in logs.T], axis=1) / np.bincount(at)[:, None]


def _log_density(size: Floats, like: Floats) -> Floats:
    """Log density (n, k) of errors under the law of others (m, k): its scale and its share of gross errors by maximum
    likelihood (Dempster, Laird, Rubin (1977), J. R. Stat. Soc. B 39)."""
    scale, share = 1.4826 * np.median(np.abs(like), axis=0) + 1e-9, np.full(like.shape[1], _SHARE)
    for _ in range(30):
        usual, gross = _weighed(like, scale, share)
        own = 1.0 / (1.0 + np.exp(np.minimum(gross - usual, 700.0)))
        weight = own * (TAILS + 1.0) / (TAILS + (like / scale) ** 2)
        scale = np.sqrt(np.sum(weight * like**2, axis=0) / (np.sum(own, axis=0) + 1e-12)) + 1e-12
        share = np.clip(np.mean(1.0 - own, axis=0), SELDOM, MOST)
    return np.asarray(np.logaddexp(*_weighed(size, scale, share)))


def _weighed(size: Floats, scale: Floats, share: Floats) -> tuple[Floats, Floats]:
    """Log densities (n, k) of errors that are as usual, and of gross ones of whatever size, times their shares (k,)."""
    usual = student.logpdf(size / scale, TAILS) - np.log(scale) + np.log1p(-share)
    gross = np.log(0.5 * share / (1.0 + _DECADES * math.log(10.0))) - np.log(np.maximum(np.abs(size), 1.0))
    return np.asarray(usual), np.asarray(gross)


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
        return self.matters and self.nats > self.half


def gained(before: Floats, after: Floats) -> Gain:
    """What the second predicts better, by the densities (b,) of both in each block; of one block nothing is sure, nor
    where their blocks are not the same.

    A prediction that begins in a block may reach into the next: neighbours vary together, and that counts (Hansen,
    Hodrick (1980), J. Polit. Econ. 88(5), for forecasts that overlap).
    """
    if len(before) < 2 or len(after) != len(before) or not np.all(np.isfinite(before) & np.isfinite(after)):
        return Gain(0.0, math.inf)
    each, n = after - before, len(before)
    off = each - float(np.mean(each))
    variance = max(float(off @ off + 2.0 * off[1:] @ off[:-1]), float(off @ off)) / (n - 1)
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, n - 1)) * math.sqrt(variance / n)
    return Gain(float(np.mean(each)), half)
