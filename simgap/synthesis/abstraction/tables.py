"""Integer offset tables on reduced axes: dimension i of a post box relative to its cell, per reduced cell and input."""

from __future__ import annotations

from functools import cache
from math import prod
from typing import Any

import numpy as np

from simgap.arrays import Ints
from simgap.geometry import Grid
from simgap.late import numba

_WHOLE, _REAL, _SHORT = "CPointer(int64)", "CPointer(float64)", "CPointer(int32)"
POST = f"void({_WHOLE}, int64, int64, int64, int64, {_WHOLE}, {_REAL}, {_SHORT}, {_SHORT})"


@cache
def table_post() -> Any:
    """The post that reads integer tables; compiled on first use and kept on disk."""
    return numba.cfunc(POST, cache=True)(_post)


def _post(k, cells, group, m0, m1, meta, data, table, out):  # type: ignore[no-untyped-def]
    n, inputs = meta[0], meta[1]
    count = m1 - m0
    for i in range(n):
        row = 2 + i * (n + 1)
        first = np.int64(0)
        for j in range(n):
            first += k[j] * meta[row + 1 + j]
        stride = meta[row + n] * inputs
        for cell in range(cells):
            at = meta[row] + 2 * (first * inputs + cell * stride + m0)
            own = k[i] + (cell if i == n - 1 else 0)
            to = 2 * n * count * cell + i
            for m in range(count):
                out[to + 2 * n * m] = own + table[at + 2 * m]
                out[to + 2 * n * m + n] = own + table[at + 2 * m + 1]


def table_meta(grid: Grid, inputs: int, axes: tuple[tuple[int, ...], ...]) -> tuple[Ints, int]:
    """Where each dimension's table lies: -> (meta for the kernel, total number of (lower, upper) pairs).

    `meta` = nx, M, then per dimension: first number, then the stride of each axis (0 for axes it does not depend on).
    """
    n = grid.box.size
    meta = np.zeros(2 + n * (n + 1), dtype=np.int64)
    meta[:2] = n, inputs
    total = 0
    for i, own in enumerate(axes):
        row = 2 + i * (n + 1)
        meta[row] = 2 * total
        stride = 1
        for j in sorted(own, reverse=True):
            meta[row + 1 + j] = stride
            stride *= grid.cells[j]
        total += stride * inputs
    return meta, total


def reduced_cells(grid: Grid, axes: tuple[int, ...]) -> Ints:
    """Cell indices over the given axes in row-major order, the middle cell along the others: -> (n, nx)."""
    ranges = [np.arange(c) if j in axes else np.array([c // 2]) for j, c in enumerate(grid.cells)]
    return np.stack([m.reshape(-1) for m in np.meshgrid(*ranges, indexing="ij")], axis=-1)


def reduced_size(grid: Grid, axes: tuple[int, ...]) -> int:
    """Number of cells over the given axes."""
    return prod(grid.cells[j] for j in axes)
