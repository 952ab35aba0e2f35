"""Local polynomials through samples at even distances, by least squares, and their derivatives (Savitzky & Golay 1964).

At the ends the polynomial of the first or last whole window counts. `scipy.signal` has the same in a package that takes
half a second to import.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from simgap.arrays import Floats


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
