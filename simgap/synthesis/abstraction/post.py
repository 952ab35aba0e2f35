"""Posts of the abstraction: boxes of successor cells from the interval kernels of model and gap, rounded outward.

Over the box B (a cell, widened by the measurement error) with centre c and half-widths r, the mean value theorem gives

    f(x, u) in f(c, u) -/+ sum_j sup_B |d f_i / d x_j| r_j   for all x in B,

or, where f jumps in B, in what interval arithmetic makes of f over B; and the successor lies in that plus
[inf_B lo_i, sup_B hi_i] of the gap.

A post reads two flat arrays. `data` holds n values each of: origin, cell width, lower clip, upper clip, measurement
error, pad; then the inputs (M, nu); then the tables of offsets. `meta` holds nx, M, nu, len(data), then for each
dimension where its table starts and its stride per axis. Where the structure allows it, offsets are tabulated on the
axes that they depend on, as integers if the gap is in them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.geometry import Grid, mesh
from simgap.late import njit, numba
from simgap.model.compile import cached_kernel, cached_kernel_as
from simgap.model.interval import iadd, imul, widen

PAD = 2.0**-42
"""Rounding pad relative to the size of the numbers on an axis: 1024 units in the last place, against at most some tens
of operations on numbers up to `LARGEST` times that size; far below a millionth of a cell."""
LARGEST = 16.0
OUTSIDE = 2**30


@dataclass(frozen=True, eq=False)
class Frame:
    """`meta` and `data` of an abstraction, without tables."""

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
        """`meta` and `data`, flat; `tables` is (2 pairs,), laid out as `table_meta` says, or None."""
        head = np.concatenate([self.header, self.inputs.reshape(-1)])
        data = head if tables is None else np.concatenate([head, tables])
        layout = table_meta(self.grid, len(self.inputs), axes)[0][2:].reshape(self.grid.box.size, -1)
        layout[:, 0] += head.size
        counts = [self.grid.box.size, *self.inputs.shape, data.size]
        return np.concatenate([np.array(counts, np.int64), layout.reshape(-1)]), data


@njit(cache=True, error_model="numpy")
def cell_box(k, n, data, lo, hi):  # type: ignore[no-untyped-def]
    """Box of true states when the measured one is in cell `k`: the cell with error and pad, inside X."""
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
    """Places of each dimension's table: -> (meta for the kernel, total number of (lower, upper) pairs).

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
    return mesh(*(np.arange(c) if j in axes else np.array([c // 2]) for j, c in enumerate(grid.cells)))


def reduced_size(grid: Grid, axes: tuple[int, ...]) -> int:
    """Number of cells over the given axes."""
    return prod(grid.cells[j] for j in axes)


Kernel = Callable[..., Any]


@njit(cache=True)
def no_gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
    """The gap kernel of the nominal model alone."""
    lo[:] = 0.0
    hi[:] = 0.0


@cache
def image(f: Kernel, jacobian: Kernel) -> Kernel:
    """numba: (xlo, xhi, u, n, lo_out, hi_out) -> None, the box of f over the box [xlo, xhi]."""

    @cached_kernel
    def image_of_box(xlo, xhi, u, n, lo, hi, c):  # type: ignore[no-untyped-def]
        for j in range(n):
            c[j] = 0.5 * (xlo[j] + xhi[j])
        value = f(c, c, u, u)
        slope = jacobian(xlo, xhi, u, u)
        for i in range(n):
            spread = 0.0
            for j in range(n):
                a, b = slope[i * n + j][0], slope[i * n + j][1]
                r = max(xhi[j] - c[j], c[j] - xlo[j])
                spread += max(-a, b) * r
            if spread < np.inf:
                lo[i] = value[i][0] - spread * (1.0 + 2.0**-48)
                hi[i] = value[i][1] + spread * (1.0 + 2.0**-48)
            else:
                lo[i], hi[i] = f(xlo, xhi, u, u)[i]

    return image_of_box


@njit(cache=True, error_model="numpy")
def group_box(index, extra, n, data, lo, hi, spare):  # type: ignore[no-untyped-def]
    """`cell_box` of the cell `index` and of the `extra` cells after it along the last axis, together."""
    if extra:
        index[n - 1] += extra
        cell_box(index, n, data, spare, hi)
        index[n - 1] -= extra
        cell_box(index, n, data, lo, spare)
    else:
        cell_box(index, n, data, lo, hi)


@cache
def direct_post(f: Kernel, jacobian: Kernel, gap: Kernel) -> Any:
    """The post that evaluates the model for every pair, because nothing can be tabulated."""
    image_of_box = image(f, jacobian)

    carray = numba.carray

    @cached_kernel_as(POST, "cfunc")
    def post(k, cells, group, m0, m1, meta, data, table, out):  # type: ignore[no-untyped-def]
        n, nu = meta[0], meta[2]
        numbers = carray(data, (meta[3],))
        index, work = np.empty(n, np.int64), np.empty((9, n))
        for j in range(n):
            index[j] = k[j]
        for start in range(0, cells, group):
            end = min(start + group, cells)
            index[n - 1] = k[n - 1] + start
            group_box(index, end - start - 1, n, numbers, work[5], work[6], work[4])
            for m in range(m0, m1):
                u = numbers[6 * n + m * nu : 6 * n + (m + 1) * nu]
                gap(work[5], work[6], u, work[7], work[8])
                for cell in range(start, end):
                    index[n - 1] = k[n - 1] + cell
                    cell_box(index, n, numbers, work[0], work[1])
                    image_of_box(work[0], work[1], u, n, work[2], work[3], work[4])
                    at = 2 * n * (cell * (m1 - m0) + m - m0)
                    for i in range(n):
                        lo, hi = to_cells(work[2, i] + work[7, i], work[3, i] + work[8, i], i, n, numbers)
                        out[at + i], out[at + n + i] = lo, hi

    return post


@cache
def tabulated_post(gap: Kernel) -> Any:
    """The post that reads the model from tables and evaluates the gap for every pair or group of pairs."""

    carray = numba.carray

    @cached_kernel_as(POST, "cfunc")
    def post(k, cells, group, m0, m1, meta, data, table, out):  # type: ignore[no-untyped-def]
        n, inputs, nu = meta[0], meta[1], meta[2]
        numbers = carray(data, (meta[3],))
        index, row, work = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((5, n))
        for i in range(n):
            index[i] = k[i]
            row[i] = 0
            for j in range(n):
                row[i] += k[j] * meta[4 + i * (n + 1) + 1 + j]
        for start in range(0, cells, group):
            end = min(start + group, cells)
            index[n - 1] = k[n - 1] + start
            group_box(index, end - start - 1, n, numbers, work[0], work[1], work[4])
            for m in range(m0, m1):
                gap(work[0], work[1], numbers[6 * n + m * nu : 6 * n + (m + 1) * nu], work[2], work[3])
                for i in range(n):
                    first, stride = meta[4 + i * (n + 1)], meta[4 + i * (n + 1) + n]
                    for cell in range(start, end):
                        entry = first + 2 * ((row[i] + cell * stride) * inputs + m)
                        own = k[i] + cell if i == n - 1 else k[i]
                        centre = numbers[i] + numbers[n + i] * (own + 0.5)
                        low, high = centre + numbers[entry] + work[2, i], centre + numbers[entry + 1] + work[3, i]
                        at = 2 * n * (cell * (m1 - m0) + m - m0) + i
                        out[at], out[at + n] = to_cells(low, high, i, n, numbers)

    return post


@njit(cache=True, error_model="numpy")
def without_ends(header, own):  # type: ignore[no-untyped-def]
    """`header` in which X has no ends along the axes where `own` (n,) is 0: boxes are not clipped along them."""
    n = own.size
    free = header.copy()
    for j in range(n):
        if not own[j]:
            free[2 * n + j], free[3 * n + j] = -np.inf, np.inf
    return free


@cache
def table_filler(f: Kernel, jacobian: Kernel) -> Kernel:
    """numba: (k (rows, n), which (d,), own (n,), header, u (M, nu), out (d, rows, M, 2)) -> None.

    Offsets of the dimensions `which` of f from the cell's centre.

    Along axes that f_i - x_i and its derivatives do not depend on (`own` 0) the box is not clipped to X, since the
    table serves all cells along them.
    """
    image_of_box = image(f, jacobian)

    @cached_kernel
    def fill(cells, which, own, header, inputs, out):  # type: ignore[no-untyped-def]
        n = own.size
        free = without_ends(header, own)
        work = np.empty((5, n))
        for row in range(cells.shape[0]):
            cell_box(cells[row], n, free, work[0], work[1])
            for m in range(inputs.shape[0]):
                image_of_box(work[0], work[1], inputs[m], n, work[2], work[3], work[4])
                for d in range(which.size):
                    i = which[d]
                    centre = header[i] + header[n + i] * (cells[row, i] + 0.5)
                    out[d, row, m, 0], out[d, row, m, 1] = work[2, i] - centre, work[3, i] - centre

    return fill


@njit(cache=True, error_model="numpy")
def fill_affine(cells, which, own, header, start, value, slope, out):  # type: ignore[no-untyped-def]
    """Filler as `table_filler`, for f affine in x: value (M, n, 2) encloses f at `start`, slope (M, n, n, 2) df/dx."""
    n = own.size
    free = without_ends(header, own)
    work = np.empty((4, n))
    for row in range(cells.shape[0]):
        cell_box(cells[row], n, free, work[0], work[1])
        for j in range(n):
            c = 0.5 * (work[0, j] + work[1, j])
            work[2, j], work[3, j] = c - start[j], max(work[1, j] - c, c - work[0, j])
        for m in range(value.shape[0]):
            for d in range(which.size):
                i = which[d]
                at, spread = (value[m, i, 0], value[m, i, 1]), 0.0
                for j in range(n):
                    s = (slope[m, i, j, 0], slope[m, i, j, 1])
                    at = iadd(at, imul(s, widen(work[2, j], work[2, j])))
                    spread += max(-s[0], s[1]) * work[3, j]
                spread *= 1.0 + 2.0**-48
                centre = header[i] + header[n + i] * (cells[row, i] + 0.5)
                out[d, row, m, 0], out[d, row, m, 1] = at[0] - spread - centre, at[1] + spread - centre


@cache
def gap_adder(gap: Kernel) -> Kernel:
    """numba: (k (rows, n), which (d,), header, u (M, nu), out (d, rows, M, 2)) -> None, the gap's bounds added."""

    @cached_kernel
    def add_gap(cells, which, header, inputs, out):  # type: ignore[no-untyped-def]
        n = cells.shape[1]
        work = np.empty((4, n))
        for row in range(cells.shape[0]):
            cell_box(cells[row], n, header, work[0], work[1])
            for m in range(inputs.shape[0]):
                gap(work[0], work[1], inputs[m], work[2], work[3])
                for d in range(which.size):
                    out[d, row, m, 0] += work[2, which[d]]
                    out[d, row, m, 1] += work[3, which[d]]

    return add_gap


@njit(cache=True, error_model="numpy")
def whole_cells(offsets, i, n, header, out):  # type: ignore[no-untyped-def]
    """Offsets from the centre of a cell as whole cells: (rows, M, 2) -> (rows, M, 2) int32."""
    axis = header.copy()
    axis[i] = -0.5 * axis[n + i]  # measured from the centre of cell 0
    for row in range(offsets.shape[0]):
        for m in range(offsets.shape[1]):
            lo, hi = to_cells(offsets[row, m, 0], offsets[row, m, 1], i, n, axis)
            out[row, m, 0], out[row, m, 1] = lo, hi
