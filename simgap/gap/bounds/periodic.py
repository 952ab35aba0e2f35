"""Boxes that cross the seam of a periodic axis, as boxes inside X.

A gap that is periodic along an axis is bounded on one period, X. A box that leaves X there is moved back by whole turns
and cut at the seam; what is moved is widened by the rounding of doing so. A box a turn wide or more is all of the axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.late import njit
from simgap.model.kept import kept

PARTS = 3
"""Parts of an interval: its own, what lies beyond the upper end of X, what rounding may have moved below the lower."""
_ROUNDING = 2.0**-49


@njit(cache=True, error_model="numpy")
def crosses(xlo, xhi, lo, hi, axes):  # type: ignore[no-untyped-def]
    """Whether a proper box leaves X along a periodic axis; one with an end that is no number is left alone."""
    found = False
    for j in axes:
        found = found or (xlo[j] <= xhi[j] and (xlo[j] < lo[j] or xhi[j] > hi[j]))
    return found


@njit(cache=True, error_model="numpy")
def cut(xlo, xhi, lo, hi, axes, piece, a, b):  # type: ignore[no-untyped-def]
    """Write the `piece`-th of PARTS ** axes parts of a box into a, b; False where there is nothing of it."""
    a[:] = xlo
    b[:] = xhi
    for j in axes:
        part = piece % PARTS
        piece //= PARTS
        turn = hi[j] - lo[j]
        if not xhi[j] - xlo[j] < turn:
            a[j], b[j] = lo[j], hi[j]
            if part > 0:
                return False
            continue
        back = np.floor((xlo[j] - lo[j]) / turn) * turn
        slack = _ROUNDING * (abs(xlo[j]) + abs(xhi[j]) + abs(lo[j]) + abs(hi[j]) + abs(back))
        start, end = xlo[j] - back - slack, xhi[j] - back + slack
        if part == 1:
            if end <= hi[j]:
                return False
            start, end = lo[j], end - turn + slack
        elif part == 2:
            if start >= lo[j]:
                return False
            start, end = start + turn - slack, hi[j]
        a[j], b[j] = max(start, lo[j]), min(end, hi[j])
    return True


def periodic_kernel(inner, box: Box, axes: tuple[int, ...]):  # type: ignore[no-untyped-def]
    """The kernel of a gap function (`GapFunction.kernel`) that answers for boxes any number of turns away from X."""
    lo, hi, wraps = box.lo.copy(), box.hi.copy(), np.array(axes, dtype=np.int64)
    count = PARTS ** len(axes)

    @kept
    def bounds_over_box(xlo, xhi, u, lower, upper):  # type: ignore[no-untyped-def]
        if not crosses(xlo, xhi, lo, hi, wraps):
            inner(xlo, xhi, u, lower, upper)
            return
        n = xlo.size
        work = np.empty((4, n))
        lower[:] = np.inf
        upper[:] = -np.inf
        for piece in range(count):
            if cut(xlo, xhi, lo, hi, wraps, piece, work[0], work[1]):
                inner(work[0], work[1], u, work[2], work[3])
                for i in range(n):
                    lower[i], upper[i] = min(lower[i], work[2, i]), max(upper[i], work[3, i])

    return bounds_over_box


def parts(xlo: Floats, xhi: Floats, box: Box, axes: tuple[int, ...]) -> list[tuple[NDArray[np.intp], Floats, Floats]]:
    """Boxes (n, nx), (n, nx) as boxes inside X along periodic axes: for each kind of part (rows, lower, upper)."""
    wraps = np.array(axes, dtype=np.int64)
    out = []
    for piece in range(PARTS ** len(axes)):
        a, b, there = np.empty(xlo.shape), np.empty(xhi.shape), np.zeros(len(xlo), np.bool_)
        _cut_rows(*(np.ascontiguousarray(v, np.float64) for v in (xlo, xhi)), box.lo, box.hi, wraps, piece, a, b, there)
        rows = np.flatnonzero(there)
        out.append((rows, a[rows], b[rows]))
    return out


@njit(cache=True, error_model="numpy")
def _cut_rows(xlo, xhi, lo, hi, axes, piece, a, b, there):  # type: ignore[no-untyped-def]
    for n in range(len(xlo)):
        if crosses(xlo[n], xhi[n], lo, hi, axes):
            there[n] = cut(xlo[n], xhi[n], lo, hi, axes, piece, a[n], b[n])
        elif piece == 0:
            a[n], b[n], there[n] = xlo[n], xhi[n], True
