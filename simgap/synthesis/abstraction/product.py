"""Posts of the product's abstraction: nominal model and gap by their interval kernels, outward rounded.

Over the box B (a cell, widened by the measurement error) with centre c and half-widths r, the mean value theorem gives

    f(x, u) in f(c, u) -/+ sum_j sup_B |d f_i / d x_j| r_j   for all x in B,

and the successor lies in that plus [inf_B lo_i, sup_B hi_i] of the gap.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from simgap.late import njit, numba
from simgap.model.interval import iadd, imul, widen
from simgap.model.kept import kept, kept_as
from simgap.synthesis.abstraction.frame import cell_box, to_cells
from simgap.synthesis.abstraction.tables import POST

Kernel = Callable[..., Any]


@njit(cache=True)
def no_gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
    """The gap kernel of the nominal model alone."""
    lo[:] = 0.0
    hi[:] = 0.0


@cache
def image(f: Kernel, jacobian: Kernel) -> Kernel:
    """numba: (xlo, xhi, u, n, lo_out, hi_out) -> None, the box of f over the box [xlo, xhi]."""

    @kept
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
            lo[i] = value[i][0] - spread * (1.0 + 2.0**-48)
            hi[i] = value[i][1] + spread * (1.0 + 2.0**-48)

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

    @kept_as(POST, "cfunc")
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

    @kept_as(POST, "cfunc")
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

    @kept
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
    """As `table_filler` where f is affine in x: value (M, n, 2) encloses f at `start`, slope (M, n, n, 2) df/dx."""
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

    @kept
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
