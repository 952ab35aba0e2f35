"""Lipschitz estimates of a sampled gap side by side: the grid estimate and the paper's extreme-value estimates.

The extreme-value estimates use blocks of random pairs within a radius (Wood & Zhang 1996): a three-parameter reverse
Weibull law is fitted to the largest slope of each block by maximum likelihood, and its location is the estimate. It is
not an upper bound, and the Kolmogorov-Smirnov test can pass when it is wrong (see `benchmarks/lipschitz.py`), so two
upper confidence limits stand beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.gap.lipschitz.grid import DimensionLipschitz, GridLipschitz, LipschitzRow, estimate, worse
from simgap.gap.lipschitz.local import enclosed_constants
from simgap.gap.sampling.samples import DimensionSamples
from simgap.gap.sampling.values import Rows, Values
from simgap.late import scipy
from simgap.statistics import chi2, extrapolated_maximum

_SHAPES = (1.0, 1e3)  # c >= 1: the likelihood is unbounded below it
_FARTHEST = 1e6  # farthest location tried, in units of the spread of the maxima
_ALIKE = 1e-9  # relative spread of maxima that is rounding: the nearest location tried would be the largest itself


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
    mesh = np.log(spread) + np.linspace(np.log(1e-6), np.log(_FARTHEST), starts)
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
    lo, hi = np.log(fitted.location - top), np.log(_FARTHEST * _spread(maxima))
    if _profile(maxima, top + np.exp(hi))[0] >= goal:
        return float(top + np.exp(hi))
    crossing = scipy.optimize.brentq(lambda t: _profile(maxima, top + np.exp(t))[0] - goal, lo, hi, xtol=1e-12)
    return float(top + np.exp(crossing))


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


_BLOCKS, _PAIRS = 100, 100  # of random pairs, and in each
_REACH = 3  # cells: pairs lie within this many cells of each other along every axis


def dimension_lipschitz(samples: DimensionSamples, settings: GapSection) -> DimensionLipschitz:
    """Lipschitz constants of one dimension; no basis and no padding enters.

    Of a gap with a range both ends are estimated, and the worse of each number is taken: a side of the bound has to
    follow its own end, and either may be the steep one. Where the gap is known in closed form its slopes are enclosed,
    and the estimates stand beside for comparison.

    Raises:
        UserError: with fewer than four cells along an axis that is not free, or a gap that cannot be enclosed.
    """
    where = samples.where
    found = reduce(worse, [estimate(d, where.grid, where.free, samples.floor) for d in samples.ends])
    rows = compare_estimates(samples, found, settings)
    if samples.ranges is not None:
        found = enclosed_constants(samples.ranges, where.grid.h)
        note = "a bound: enclosed on every cell" if found.resolved else "a bound where there is no jump"
        rows = (LipschitzRow("interval enclosure", found.euclidean, None, note), *rows)
    return DimensionLipschitz(found, rows, samples.largest)


def compare_estimates(
    samples: DimensionSamples, found: GridLipschitz, settings: GapSection
) -> tuple[LipschitzRow, ...]:
    """The grid estimate and, if the settings ask for them, extreme-value ones from random pairs of grid samples."""
    worst = f"L(h/2)/L(h) = {found.ratio.max():.3f}" + ("" if found.resolved else ", not resolved")
    rows = [LipschitzRow("grid", found.euclidean, None, worst)]
    moving = [j for j in range(len(samples.where.states)) if j not in samples.where.free]
    if not settings.lipschitz.extreme_value or not moving:
        return tuple(rows)
    slopes = _grid_pair_slopes(samples, moving, settings)
    maxima = slopes.max(axis=1)
    if not np.ptp(maxima) > _ALIKE * maxima.max():
        return (*rows, LipschitzRow("largest slope of pairs", float(maxima.max()), None, "all blocks agree"))
    law = fit_reverse_weibull(maxima)
    top = extrapolated_maximum(slopes.ravel(), 2 * len(moving))  # a pair has twice as many coordinates
    return (
        *rows,
        LipschitzRow("largest slope of pairs", float(maxima.max()), None, "a lower bound"),
        LipschitzRow("reverse Weibull location", law.location, law.ks_p, f"shape {law.shape:.3g}; not an upper bound"),
        LipschitzRow("profile likelihood, 95 %", profile_upper(maxima, law), law.ks_p, "upper confidence limit"),
        LipschitzRow("top-20 spacing, 95 %", top, None, "upper confidence limit"),
    )


def _grid_pair_slopes(samples: DimensionSamples, moving: list[int], settings: GapSection) -> Floats:
    """Slopes of random pairs of samples with the same input, of a range the steeper end's: (blocks, pairs).

    One stream of random numbers serves the dimensions in order, so those of the dimensions before are drawn and left.
    """
    where, rng = samples.where, np.random.default_rng(settings.seed)
    shape = (_BLOCKS, _PAIRS)
    cells = np.array(where.grid.cells)
    for _ in range(samples.i + 1):
        first = rng.integers(0, cells, size=(*shape, len(cells)))
        step = np.zeros_like(first)
        step[..., moving] = rng.integers(-_REACH, _REACH + 1, size=(*shape, len(moving)))
        m = rng.integers(0, len(where.inputs), size=shape)
    still = ~step.any(axis=-1)
    step[still, moving[0]] = 1
    second = first + step
    second = np.where((second < 0) | (second >= cells), first - step, second)
    second = np.clip(second, 0, cells - 1)
    flat = [np.ravel_multi_index(tuple(np.moveaxis(k, -1, 0)), tuple(cells)) for k in (first, second)]
    change = np.maximum.reduce([np.abs(_picked(d, flat[0], m) - _picked(d, flat[1], m)) for d in samples.ends])
    distance = np.linalg.norm((second - first) * 2.0 * where.grid.h, axis=-1)
    return change / np.where(distance > 0.0, distance, np.inf)


def _picked(d: Values, rows: Rows, m: Rows) -> Floats:
    """Single numbers of (N, M) values, in the shape of `rows` and `m`."""
    return d[rows.ravel()][np.arange(rows.size), m.ravel()].reshape(rows.shape)
