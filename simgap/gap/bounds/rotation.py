"""Boxes of the body frame seen from the world: the range of `R(theta) b` over a box and an interval of theta.

Each coordinate of R(theta) b is linear in b, so its extremes are at corners of the box; for a corner at distance r and
bearing phi it is r cos(theta + phi) or r sin(theta + phi), with extremes at the ends of the interval and where the
angle is a multiple of pi or an odd multiple of pi/2.
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.late import njit

_SLACK = 1e-13  # relative: arctan2, cos and hypot are each off by some 1e-16, angles are below 100 rad


@njit(cache=True, error_model="numpy")
def cosine_range(lo, hi):  # type: ignore[no-untyped-def]
    """Smallest and largest cosine on [lo, hi]; exact up to rounding, which the caller covers."""
    a, b = np.cos(lo), np.cos(hi)
    low, high = min(a, b), max(a, b)
    if np.floor(hi / (2.0 * np.pi) + 1e-12) >= np.ceil(lo / (2.0 * np.pi) - 1e-12):
        high = 1.0
    if np.floor((hi - np.pi) / (2.0 * np.pi) + 1e-12) >= np.ceil((lo - np.pi) / (2.0 * np.pi) - 1e-12):
        low = -1.0
    return low, high


@njit(cache=True, error_model="numpy")
def rotated_box(t0, t1, a0, a1, b0, b1):  # type: ignore[no-untyped-def]
    """Hull of R(theta) [a0, a1] x [b0, b1] over theta in [t0, t1]: -> x0, x1, y0, y1, rounded outward."""
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(4):
        a = a1 if corner & 1 else a0
        b = b1 if corner & 2 else b0
        r, phi = np.hypot(a, b), np.arctan2(b, a)
        low, high = cosine_range(t0 + phi, t1 + phi)
        x0, x1 = min(x0, r * low), max(x1, r * high)
        low, high = cosine_range(t0 + phi - 0.5 * np.pi, t1 + phi - 0.5 * np.pi)
        y0, y1 = min(y0, r * low), max(y1, r * high)
    slack = _SLACK * (max(abs(a0), abs(a1)) + max(abs(b0), abs(b1))) * (1.0 + abs(t0) + abs(t1)) + 1e-300
    return x0 - slack, x1 + slack, y0 - slack, y1 + slack


def to_body(d: Floats, heading: Floats, pose: tuple[int, int, int] = (0, 1, 2)) -> Floats:
    """Differences (n, 3) of the world turned into the frames of the given headings (n,): R(-heading) d."""
    i, j, _ = pose
    cos, sin = np.cos(heading), np.sin(heading)
    out = d.copy()
    out[..., i] = cos * d[..., i] + sin * d[..., j]
    out[..., j] = -sin * d[..., i] + cos * d[..., j]
    return out
