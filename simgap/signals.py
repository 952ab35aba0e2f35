"""A multisine as input, and local polynomials through evenly spaced samples with their derivatives.

The polynomials are by least squares (Savitzky & Golay 1964).

At the ends the polynomial of the first or last whole window counts. `scipy.signal` has the same in a package that takes
half a second to import.
"""

from __future__ import annotations

import math
from functools import lru_cache
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


def savgol_coeffs(size: int, order: int, deriv: int = 0, delta: float = 1.0) -> Floats:
    """Weights of a window of odd size, (size,), in the order of a convolution: the last sample first."""
    return _weights(size, order, deriv)[size // 2, ::-1] / delta**deriv


def savgol_filter(y: Floats, size: int, order: int, deriv: int = 0, delta: float = 1.0) -> Floats:
    """A derivative of the local polynomials, (n,) -> (n,).

    Args:
        size: samples of a window, odd and at most n; order: of the polynomial; delta: between samples.
    """
    weights, half = _weights(size, order, deriv), size // 2
    inner = np.convolve(y, weights[half, ::-1], mode="valid")
    return np.concatenate([weights[:half] @ y[:size], inner, weights[half + 1 :] @ y[-size:]]) / delta**deriv


@lru_cache(maxsize=16)
def _weights(size: int, order: int, deriv: int) -> Floats:
    """Row k: the derivative at sample k of the polynomial through a window, in units of samples, (size, size)."""
    at = (np.arange(size) - size // 2) / max(size // 2, 1)  # within [-1, 1], where powers are well told apart
    powers = np.arange(order + 1)
    fitted = np.linalg.pinv(at[:, None] ** powers)
    factors = np.array([math.perm(p, deriv) for p in powers.tolist()], dtype=float)
    derived = factors * at[:, None] ** np.maximum(powers - deriv, 0)
    return np.asarray(derived @ fitted) / max(size // 2, 1) ** deriv
