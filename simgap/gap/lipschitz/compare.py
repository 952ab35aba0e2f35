"""Lipschitz estimates of a sampled gap side by side: the grid estimate and the paper's extreme-value estimates."""

from __future__ import annotations

from functools import reduce

import numpy as np

from simgap.arrays import Floats
from simgap.gap.lipschitz.enclosed import enclosed_constants
from simgap.gap.lipschitz.evt import fit_reverse_weibull, profile_upper, top_spacing_upper
from simgap.gap.lipschitz.grid import estimate
from simgap.gap.lipschitz.result import DimensionLipschitz, GridLipschitz, LipschitzRow, worse
from simgap.gap.sampling.samples import DimensionSamples
from simgap.gap.sampling.values import Rows, Values
from simgap.gap.settings import GapSettings

_REACH = 3  # cells: pairs lie within this many cells of each other along every axis


def dimension_lipschitz(samples: DimensionSamples, settings: GapSettings) -> DimensionLipschitz:
    """What is known about the Lipschitz constant of one dimension; no basis and no padding enters.

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
    samples: DimensionSamples, found: GridLipschitz, settings: GapSettings
) -> tuple[LipschitzRow, ...]:
    """The grid estimate and, if the settings ask for them, extreme-value ones from random pairs of grid samples."""
    worst = f"L(h/2)/L(h) = {found.ratio.max():.3f}" + ("" if found.resolved else ", not resolved")
    rows = [LipschitzRow("grid", found.euclidean, None, worst)]
    moving = [j for j in range(len(samples.where.states)) if j not in samples.where.free]
    if not settings.extreme_value or not moving:
        return tuple(rows)
    slopes = _grid_pair_slopes(samples, moving, settings)
    maxima = slopes.max(axis=1)
    if not np.ptp(maxima) > 1e-12 * maxima.max():
        return (*rows, LipschitzRow("largest slope of pairs", float(maxima.max()), None, "all blocks agree"))
    law = fit_reverse_weibull(maxima)
    top = top_spacing_upper(slopes.ravel(), 2 * len(moving))
    return (
        *rows,
        LipschitzRow("largest slope of pairs", float(maxima.max()), None, "a lower bound"),
        LipschitzRow("reverse Weibull location", law.location, law.ks_p, f"shape {law.shape:.3g}; not an upper bound"),
        LipschitzRow("profile likelihood, 95 %", profile_upper(maxima, law), law.ks_p, "upper confidence limit"),
        LipschitzRow("top-20 spacing, 95 %", top, None, "upper confidence limit"),
    )


def _grid_pair_slopes(samples: DimensionSamples, moving: list[int], settings: GapSettings) -> Floats:
    """Slopes of random pairs of samples with the same input, of a range the steeper end's: (blocks, pairs).

    One stream of random numbers serves the dimensions in order, so those of the dimensions before are drawn and left.
    """
    where, rng = samples.where, np.random.default_rng(settings.seed)
    shape = (settings.extreme_value_blocks, settings.extreme_value_pairs)
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
    return d.take(rows.ravel())[np.arange(rows.size), m.ravel()].reshape(rows.shape)
