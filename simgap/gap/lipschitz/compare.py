"""Lipschitz estimates of a sampled gap side by side: the grid estimate and the paper's extreme-value estimates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.gap.lipschitz.evt import fit_reverse_weibull, profile_upper, top_spacing_upper
from simgap.gap.lipschitz.grid import GridLipschitz
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.geometry import Floats

_REACH = 3  # cells: pairs lie within this many cells of each other along every axis


@dataclass(frozen=True)
class LipschitzRow:
    """One estimate of the Euclidean constant: method, value, p-value of its goodness of fit (None: no fit), note."""

    method: str
    value: float
    ks_p: float | None
    note: str

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"method": self.method, "value": self.value, "ks_p": self.ks_p, "note": self.note}


def compare_estimates(
    samples: GapSamples, i: int, found: GridLipschitz, settings: GapSettings, rng: np.random.Generator
) -> tuple[LipschitzRow, ...]:
    """Estimates for dimension i; extreme-value ones from random pairs of grid samples, if the settings ask for them."""
    worst = f"L(h/2)/L(h) = {found.ratio.max():.3f}" + ("" if found.resolved else ", not resolved")
    rows = [LipschitzRow("grid", found.euclidean, None, worst)]
    moving = [j for j in range(len(samples.states)) if j not in samples.free]
    if not settings.extreme_value or not moving:
        return tuple(rows)
    slopes = _grid_pair_slopes(samples, i, moving, settings, rng)
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


def _grid_pair_slopes(
    samples: GapSamples, i: int, moving: list[int], settings: GapSettings, rng: np.random.Generator
) -> Floats:
    """Slopes of random pairs of samples with the same input: (blocks, pairs)."""
    shape = (settings.extreme_value_blocks, settings.extreme_value_pairs)
    cells = np.array(samples.grid.cells)
    first = rng.integers(0, cells, size=(*shape, len(cells)))
    step = np.zeros_like(first)
    step[..., moving] = rng.integers(-_REACH, _REACH + 1, size=(*shape, len(moving)))
    still = ~step.any(axis=-1)
    step[still, moving[0]] = 1
    second = first + step
    second = np.where((second < 0) | (second >= cells), first - step, second)
    second = np.clip(second, 0, cells - 1)
    m = rng.integers(0, len(samples.inputs), size=shape)
    flat = [np.ravel_multi_index(tuple(np.moveaxis(k, -1, 0)), tuple(cells)) for k in (first, second)]
    change = samples.d[flat[0], m, i] - samples.d[flat[1], m, i]
    distance = np.linalg.norm((second - first) * 2.0 * samples.grid.h, axis=-1)
    return np.abs(change) / np.where(distance > 0.0, distance, np.inf)
