"""The numbers that a product post reads: grid, clipping, measurement error, rounding pad, inputs, offset tables.

`data` holds n values each of: origin, cell width, lower clip, upper clip, measurement error, pad; then the inputs
(M, nu); then the tables. `meta` holds nx, M, nu, len(data), then for each dimension where its table starts and its
stride per axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.geometry import Grid
from simgap.late import njit
from simgap.synthesis.abstraction.tables import table_meta

PAD = 2.0**-42
"""Rounding pad relative to the size of the numbers on an axis: 1024 units in the last place, against at most some tens
of operations on numbers up to `LARGEST` times that size; far below a millionth of a cell."""
LARGEST = 16.0
OUTSIDE = 2**30


@dataclass(frozen=True, eq=False)
class Frame:
    """`meta` and `data` of a product abstraction, without tables."""

    grid: Grid
    inputs: Floats
    error: Floats

    @property
    def scale(self) -> Floats:
        """Size of the numbers on each axis, (nx,)."""
        box = self.grid.box
        return np.maximum(np.abs(box.lo), np.abs(box.hi)) + (box.hi - box.lo)

    @property
    def header(self) -> Floats:
        """The numbers about the axes, (6 nx,)."""
        grid, free = self.grid, list(self.grid.periodic)
        pad = PAD * self.scale
        lo, hi = grid.box.lo - pad, grid.box.hi + pad
        lo[free], hi[free] = -np.inf, np.inf
        return np.concatenate([grid.box.lo, 2.0 * grid.h, lo, hi, self.error, pad])

    def arrays(self, axes: tuple[tuple[int, ...], ...], tables: Floats | None) -> tuple[Ints, Floats]:
        """`meta` and `data`, flat; `tables` is (2 pairs,), laid out as `tables.table_meta` says, or None."""
        head = np.concatenate([self.header, self.inputs.reshape(-1)])
        data = head if tables is None else np.concatenate([head, tables])
        layout = table_meta(self.grid, len(self.inputs), axes)[0][2:].reshape(self.grid.box.size, -1)
        layout[:, 0] += head.size
        counts = [self.grid.box.size, *self.inputs.shape, data.size]
        return np.concatenate([np.array(counts, np.int64), layout.reshape(-1)]), data


@njit(cache=True, error_model="numpy")
def cell_box(k, n, data, lo, hi):  # type: ignore[no-untyped-def]
    """Where the true state can be when the measured one is in cell `k`: the cell with error and pad, inside X."""
    for j in range(n):
        left = data[j] + data[n + j] * k[j]
        grow = data[4 * n + j] + data[5 * n + j]
        lo[j] = max(left - grow, data[2 * n + j])
        hi[j] = min(left + data[n + j] + grow, data[3 * n + j])


@njit(cache=True, error_model="numpy")
def cell_boxes(cells, data, lo, hi):  # type: ignore[no-untyped-def]
    """`cell_box` of many cells (rows, n) -> lo, hi (rows, n)."""
    for row in range(cells.shape[0]):
        cell_box(cells[row], cells.shape[1], data, lo[row], hi[row])


@njit(cache=True, error_model="numpy")
def to_cells(lo, hi, i, n, data):  # type: ignore[no-untyped-def]
    """Cells of axis `i` in which [lo, hi] can be measured; far outside when a bound is not finite or far too large."""
    origin, width, grow = data[i], data[n + i], data[4 * n + i] + data[5 * n + i]
    largest = LARGEST * data[5 * n + i] / PAD
    if not (-largest < lo and hi < largest):
        return -OUTSIDE, OUTSIDE
    return np.int64(np.floor((lo - grow - origin) / width)), np.int64(np.floor((hi + grow - origin) / width))
