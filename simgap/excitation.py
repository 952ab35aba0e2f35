"""Inputs that make a plant show what it is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats


def multisine(
    t: NDArray[np.floating[Any]], amplitude: float, low: float, high: float, rng: np.random.Generator
) -> Floats:
    """A random-phase multisine (n,) with equal lines from `low` to `high` Hz, scaled to a peak of `amplitude`.

    Lines stand 1 / duration apart, so that each fits a whole number of periods; at least one line is used.
    """
    spacing = 1.0 / (t[-1] - t[0])
    lines = np.arange(np.ceil(low / spacing), np.floor(high / spacing) + 1) * spacing
    if len(lines) == 0:
        lines = np.array([0.5 * (low + high)])
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    wave = np.cos(2.0 * np.pi * np.outer(t, lines) + phases).sum(axis=1)
    return np.asarray(amplitude * wave / np.abs(wave).max(), dtype=np.float64)
