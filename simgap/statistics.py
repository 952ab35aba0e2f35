"""Split conformal prediction, extrapolated maxima, and distributions by the names that `scipy.stats` gives them.

Split conformal prediction says how far scores of held-out samples reach with a stated coverage. Of n exchangeable
scores the k-th smallest, k = ceil((n + 1) level), is not exceeded by a further one with probability at least `level`.
Scores that depend on each other come in pieces (blocks of a run, or whole runs): if the pieces are exchangeable, each
score of a piece of N weighs 1 / ((m + 1) N), m of them in all, and what reaches `level` is not exceeded by a random
score of a further piece with that probability, however scores depend within a piece. A piece a score is the first rule.
Sources: Vovk, Gammerman and Shafer (2005), Algorithmic Learning in a Random World; Lei et al. (2018), Distribution-Free
Predictive Inference for Regression; Lee, Barber and Willett (2023), Distribution-Free Inference with Hierarchical Data.

The distributions are made of special functions: `scipy.stats` takes half a second to import, `scipy.special` a tenth of
that; the same functions give the same numbers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.late import scipy

_ROUNDING = 1e-12  # of sums of weights


def reach(scores: Floats, level: float, piece: Ints | None = None) -> float:
    """The smallest score that the weights of those up to it bring to `level`; infinite if there are too few pieces.

    Args:
        scores: (n,); piece: (n,) to which of the pieces each belongs; each by itself if not given.
    """
    if piece is None:
        rank = _rank(len(scores), level)
        return float(np.partition(scores, rank - 1)[rank - 1]) if rank <= len(scores) else math.inf
    _, own, sizes = np.unique(piece, return_inverse=True, return_counts=True)
    order = np.argsort(scores)
    weights = np.cumsum(1.0 / sizes[own][order]) / (len(sizes) + 1)
    rank = int(np.searchsorted(weights, level - _ROUNDING))
    return float(scores[order[rank]]) if rank < len(scores) else math.inf


def attained(pieces: int, level: float) -> float:
    """Level that so many independent pieces attain: the largest score of m holds with m / (m + 1)."""
    return level if pieces >= fewest(level) else pieces / (pieces + 1)


def fewest(level: float) -> int:
    """The smallest number of scores whose reach is finite."""
    n = max(1, math.floor(level / (1.0 - level)) - 1)
    while _rank(n, level) > n:
        n += 1
    return n


def _rank(n: int, level: float) -> int:
    return math.ceil((n + 1) * level)


def fewest_draws(missed: float, doubt: float, extremes: int) -> int:
    """The fewest draws whose hull, of so many extremes, misses more than `missed` with at most the probability `doubt`.

    What the hull of K independent draws misses has at most the distribution Beta(extremes, K - extremes + 1): of one
    number, with 2 extremes, that is the rule of Wilks (1941), Determination of Sample Sizes for Setting Tolerance
    Limits; of a box in n dimensions, with 2 n, of Tukey (1947), Non-Parametric Estimation II, and of Campi and Garatti
    (2008), The Exact Feasibility of Randomized Solutions of Uncertain Convex Programs.
    """

    def too_few(draws: int) -> bool:
        return float(scipy.special.betaincc(extremes, draws - extremes + 1, missed)) > doubt

    low, high = extremes - 1, extremes
    while too_few(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if too_few(middle) else (low, middle)
    return high


def clopper_pearson_lower(n: int, violations: int, confidence: float) -> float:
    """One-sided lower bound of a probability from `violations` among `n` iid trials (Clopper & Pearson 1934)."""
    return float(scipy.special.betaincinv(violations, n - violations + 1, 1.0 - confidence)) if violations else 0.0


class norm:
    """The standard normal distribution."""

    @staticmethod
    def cdf(x: Any) -> Any:
        """Probability of no more than x."""
        return scipy.special.ndtr(x)

    @staticmethod
    def ppf(p: Any) -> Any:
        """Its inverse."""
        return scipy.special.ndtri(p)


class chi2:
    """The distribution of the sum of `free` squared standard normal numbers."""

    @staticmethod
    def ppf(p: Any, free: Any) -> Any:
        """Quantile: not exceeded with probability p."""
        return 2.0 * scipy.special.gammaincinv(np.asarray(free) / 2.0, p)

    @staticmethod
    def isf(p: Any, free: Any) -> Any:
        """Upper quantile: exceeded with probability p."""
        return scipy.special.chdtri(free, p)


class student:
    """Student's t."""

    @staticmethod
    def ppf(p: Any, free: Any) -> Any:
        """Quantile: not exceeded with probability p."""
        return scipy.special.stdtrit(free, p)

    @staticmethod
    def logpdf(x: Any, free: float) -> Any:
        """Log of the density."""
        whole = np.log(scipy.special.poch(0.5 * free, 0.5)) - 0.5 * (math.log(free) + math.log(math.pi))
        return whole - (free + 1.0) / 2.0 * np.log1p(x * x / free)


class fisher:
    """The distribution of the ratio of two mean squares."""

    @staticmethod
    def ppf(p: Any, free: Any, free_below: Any) -> Any:
        """Quantile: not exceeded with probability p."""
        return scipy.special.fdtri(free, free_below, p)


TOP, TOP_CONFIDENCE = 20, 0.95
"""Largest samples from which a supremum is extrapolated, and confidence of that limit."""


def extrapolated_maximum(excess: Floats, dimension: int, top: int = TOP, confidence: float = TOP_CONFIDENCE) -> float:
    """Upper estimate of the supremum behind excesses (n,), >= their maximum (0 when nothing exceeds).

    `M1 + (M1 - Mk) r / (1 - r)`, `r = (1 - (1 - confidence)^(1/(k - 1)))^(1/a)`, from the k largest, where the samples
    fill `dimension` a: the more coordinates, the farther the largest sample lies from the supremum (de Haan 1981).
    """
    k = min(top, len(excess))
    largest = np.sort(excess)[-k:]
    if k < 2 or largest[-1] <= 0:
        return max(float(largest[-1]), 0.0)
    r = (1.0 - (1.0 - confidence) ** (1.0 / (k - 1))) ** (1.0 / dimension)
    return float(largest[-1] + (largest[-1] - max(largest[0], 0.0)) * r / (1.0 - r))
