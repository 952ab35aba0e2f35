"""Which boxes of cells lie wholly inside a set: one look-up in a summed-area table of the cells outside it.

The table counts *holes* (cells not in the set), so a box lies inside exactly when its count is zero. A periodic axis
is stored twice in a row, so that a box that runs across the seam is one contiguous range.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Counts = NDArray[np.int32]


def layout(cells: tuple[int, ...], periodic: tuple[int, ...]) -> Ints:
    """Describe an n-dimensional set of cells to the kernels of this module, n <= 4.

    Returns:
        (4, 4) int64: rows `cells`, `periodic` (0/1), `padded` lengths of the table, `strides` of the table; axis 0 first.
    """
    n = len(cells)
    out = np.zeros((4, 4), dtype=np.int64)
    out[0, :n] = cells
    out[1, list(periodic)] = 1
    out[2, :n] = [c * (2 if j in periodic else 1) + 1 for j, c in enumerate(cells)]
    out[3, n - 1] = 1
    for j in range(n - 2, -1, -1):
        out[3, j] = out[3, j + 1] * out[2, j + 1]
    return out


def table_size(shape: Ints, n: int) -> int:
    """Numbers in the table of `layout(...)` on n axes."""
    return int(np.prod(shape[2, :n]))


@nb.njit(cache=True, nogil=True)
def count_holes(inside, shape, n, table):  # type: ignore[no-untyped-def]
    """Fill `table` with the summed-area counts of the cells where `inside` (flat, row-major, uint8) is 0."""
    table[:] = 0
    start = 4 - n
    c = np.ones(4, np.int64)
    p = np.ones(4, np.int64)
    s = np.zeros(4, np.int64)
    for j in range(n):
        c[start + j] = shape[0, j]
        p[start + j] = shape[2, j] - 1
        s[start + j] = shape[3, j]
    shift = s[0] + s[1] + s[2] + s[3]
    for i0 in range(p[0]):
        for i1 in range(p[1]):
            for i2 in range(p[2]):
                source = (((i0 % c[0]) * c[1] + i1 % c[1]) * c[2] + i2 % c[2]) * c[3]
                target = shift + i0 * s[0] + i1 * s[1] + i2 * s[2]
                total = np.int32(0)
                for i3 in range(p[3]):
                    total += np.int32(1) - inside[source + (i3 if i3 < c[3] else i3 - c[3])]
                    table[target + i3] = total
    for j in range(n - 1):
        stride, length = shape[3, j], shape[2, j]
        for outer in range(table.size // (stride * length)):
            first = outer * stride * length
            for i in range(first + stride, first + stride * length):
                table[i] += table[i - stride]


@nb.njit(cache=True, nogil=True, inline="always")
def clip_box(box, at, shape, n):  # type: ignore[no-untyped-def]
    """Bring the 2n cell indices `box[at:]` (lower n, upper n) into the table's range; False if the box leaves the grid.

    A periodic axis is shifted so that its lower index lies in [0, cells); a box at least a full turn wide becomes the
    whole axis.
    """
    for j in range(n):
        lo, hi, cells = box[at + j], box[at + n + j], shape[0, j]
        if shape[1, j]:
            if hi - lo >= cells:
                lo, hi = 0, cells - 1
            else:
                turns = lo // cells
                lo, hi = lo - turns * cells, hi - turns * cells
            box[at + j], box[at + n + j] = lo, hi
        elif lo < 0 or hi >= cells:
            return False
    return True


@nb.njit(cache=True, nogil=True, inline="always")
def holes_in(table, shape, n, box, at):  # type: ignore[no-untyped-def]
    """Number of holes in the clipped box `box[at:]`: 2, 4, 8 or 16 loads."""
    if n == 2:
        s0 = shape[3, 0]
        a, b = box[at] * s0, (box[at + 2] + 1) * s0
        c, d = box[at + 1], box[at + 3] + 1
        return table[b + d] - table[a + d] - table[b + c] + table[a + c]
    if n == 3:
        s0, s1 = shape[3, 0], shape[3, 1]
        a, b = box[at] * s0, (box[at + 3] + 1) * s0
        c, d = box[at + 1] * s1, (box[at + 4] + 1) * s1
        e, f = box[at + 2], box[at + 5] + 1
        upper = table[b + d + f] - table[a + d + f] - table[b + c + f] + table[a + c + f]
        lower = table[b + d + e] - table[a + d + e] - table[b + c + e] + table[a + c + e]
        return upper - lower
    if n == 1:
        return table[box[at + 1] + 1] - table[box[at]]
    total = np.int32(0)
    for corner in range(16):
        sign = np.int32(1)
        index = np.int64(0)
        for j in range(4):
            if corner >> j & 1:
                index += box[at + j] * shape[3, j]
                sign = -sign
            else:
                index += (box[at + 4 + j] + 1) * shape[3, j]
        total += sign * table[index]
    return total
