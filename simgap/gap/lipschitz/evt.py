"""Extreme-value estimates of a Lipschitz constant from random pairs (Wood & Zhang 1996; the paper's method).

Blocks of random pairs within a radius; the largest slope of each block; a three-parameter reverse Weibull fitted to
these maxima by maximum likelihood; its location is the estimate. It is not an upper bound, and the Kolmogorov-Smirnov
test can pass when it is wrong (see `benchmarks/lipschitz.py`), so two upper confidence limits stand beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.distributions import chi2
from simgap.late import scipy

_SHAPES = (1.0, 1e3)  # c >= 1: the likelihood is unbounded below it
_REACH = 1e6  # farthest location tried, in units of the spread of the maxima


@dataclass(frozen=True)
class ReverseWeibull:
    """A fitted reverse Weibull law: shape, location (the estimate), scale, log-likelihood, and the KS p-value."""

    shape: float
    location: float
    scale: float
    log_likelihood: float
    ks_p: float


def fit_reverse_weibull(maxima: Floats, starts: int = 80) -> ReverseWeibull:
    """Maximum likelihood for maxima (n,), shape >= 1, by profiling: location on a logarithmic mesh, then refined.

    For a location the scale is known in closed form and the shape is a one-dimensional maximum, so no start is lost.
    """
    top, spread = float(maxima.max()), _spread(maxima)
    mesh = np.log(spread) + np.linspace(np.log(1e-6), np.log(_REACH), starts)
    values = np.array([_profile(maxima, top + np.exp(t))[0] for t in mesh])
    k = int(values.argmax())
    ends = mesh[max(k - 1, 0)], mesh[min(k + 1, starts - 1)]
    fine = scipy.optimize.minimize_scalar(
        lambda t: -_profile(maxima, top + np.exp(t))[0], bounds=ends, method="bounded"
    )
    location = top + float(np.exp(fine.x if -fine.fun >= values[k] else mesh[k]))
    likelihood, shape = _profile(maxima, location)
    farthest = location - float(maxima.min())
    scale = farthest * float(np.mean(((location - maxima) / farthest) ** shape) ** (1.0 / shape))
    p = float(scipy.stats.kstest(maxima, scipy.stats.weibull_max(shape, loc=location, scale=scale).cdf).pvalue)
    return ReverseWeibull(shape, location, scale, likelihood, p)


def profile_upper(maxima: Floats, fitted: ReverseWeibull, confidence: float = 0.95) -> float:
    """Largest location whose profile likelihood is within the one-sided `confidence` limit of the optimum.

    `maxima` is (n,).
    """
    drop = 0.5 * float(chi2.ppf(2.0 * confidence - 1.0, 1))
    top, goal = float(maxima.max()), fitted.log_likelihood - drop
    lo, hi = np.log(fitted.location - top), np.log(_REACH * _spread(maxima))
    if _profile(maxima, top + np.exp(hi))[0] >= goal:
        return float(top + np.exp(hi))
    for _ in range(60):
        middle = 0.5 * (lo + hi)
        lo, hi = (middle, hi) if _profile(maxima, top + np.exp(middle))[0] >= goal else (lo, middle)
    return float(top + np.exp(hi))


def top_spacing_upper(slopes: Floats, dimension: int, k: int = 20, confidence: float = 0.95) -> float:
    """Upper limit from the k largest slopes of (n,), whose tail behaves as distance^dimension near the end point.

    `M1 + (M1 - Mk) r / (1 - r)` with `r = (1 - (1 - confidence)^(1/(k-1)))^(1/dimension)`; `dimension` is that of the
    space of pairs.
    """
    largest = np.sort(slopes)[::-1][:k]
    r = (1.0 - (1.0 - confidence) ** (1.0 / (k - 1))) ** (1.0 / dimension)
    return float(largest[0] + (largest[0] - largest[-1]) * r / (1.0 - r))


def _spread(maxima: Floats) -> float:
    return float(np.ptp(maxima)) or abs(float(maxima.max())) * 1e-12 or 1e-300


def _profile(maxima: Floats, location: float) -> tuple[float, float]:
    """Profile log-likelihood of a location and its shape: the maximum over the shape, the scale in closed form."""
    z = np.maximum(location - maxima, 1e-300)
    z = z / z.max()
    log_z, n = np.log(z), len(z)
    unit = float((location - maxima).max())

    def negative(log_shape: float) -> float:
        c = float(np.exp(log_shape))
        return -(n * np.log(c) - n * np.log(np.mean(z**c)) + (c - 1.0) * log_z.sum() - n - n * np.log(unit))

    found = scipy.optimize.minimize_scalar(
        negative, bounds=tuple(np.log(_SHAPES)), method="bounded", options={"xatol": 1e-6}
    )
    return -float(found.fun), float(np.exp(found.x))
