"""One-step margins: by how much gamma could grow at a winning cell before no admissible input keeps it there.

With gamma = [lo, hi] over the cell, half-width w = (hi - lo) / 2, and an admissible input m, the successor box of the
cell is that of f, moved by lo and hi (`product`). The margin of a cell is

    factor    = max over m of the largest s such that the box, grown by (s - 1) w on both sides along every axis,
    extra_i   = max over m of the largest e such that the box, grown by e on both sides along axis i alone,

still covers winning cells only. Admissible are the controller's inputs: towards a target those that go down a level.
Where the class of the previous input is remembered, gamma and the inputs are those after an input of one class, and the
cells that are covered have to win after an input of the class of m.
It is a statement about one cell and one step: gamma has grown at this cell alone and the winning domain is the old one.
Where gamma grows everywhere, cells may be lost sooner, since those that they rely on are lost first. What the path
between samples touches is not asked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.geometry import Grid
from simgap.model.kept import kept
from simgap.synthesis.frame import Frame, cell_box, to_cells
from simgap.synthesis.holes import count_holes, layout, table_size
from simgap.synthesis.nominal import Model
from simgap.synthesis.product import Kernel, image
from simgap.synthesis.tables import reduced_cells

Floats = NDArray[np.float64]
LARGEST_FACTOR = 1e4
"""Factors are looked for up to here; a margin that reaches it is at least that."""
RESOLUTION = 2e-3
"""Relative accuracy of a margin, which is rounded down."""


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of cells, NaN where a cell does not win or is the goal.

    Attributes:
        factor: (cells,) on gamma's half-width, at most `LARGEST_FACTOR`.
        extra: (cells, nx) for each state alone, in its unit, at most the width of the region.
        only: of which cells, where it is not all of them, as words.
    """

    factor: NDArray[np.float32]
    extra: NDArray[np.float32]
    only: str = ""


@dataclass(frozen=True, eq=False)
class Remembered:
    """What a controller that remembers the class of the previous input adds.

    Attributes:
        winning: (cells, C) bool, cells that win after an input of each class. kind: (M,) class of each input.
        layers: indices along the last axis on which boxes depend that are looked at, all when None: nodes are many.
    """

    winning: NDArray[np.bool_]
    kind: NDArray[np.int64]
    layers: NDArray[np.int64] | None = None


def shown_layers(cells: int, count: int = 6) -> NDArray[np.int64]:
    """At most `count` indices spread over an axis of so many cells, the first included."""
    return np.unique((np.arange(count) * cells) // count)


def one_step_margins(
    model: Model,
    grid: Grid,
    inputs: Floats,
    gap: Kernel,
    winning: NDArray[np.bool_],
    mask: NDArray[np.uint8],
    gap_axes: Sequence[int] | None = None,
    error: ArrayLike | None = None,
    remembered: Remembered | None = None,
) -> Margins:
    """Margins of the cells that win and have an input.

    Args:
        model: nominal map f; grid: cells of the measured state; inputs: U, (M, nu).
        gap: kernel of the bound; gap_axes: state axes on which it depends, all when None.
        winning: (cells,) bool; mask: (cells, ceil(M / 8)) packed admissible inputs.
        error: bound of the measurement error that boxes account for, (nx,).
        remembered: where successors must win instead, if the controller remembers the class of the previous input; gap,
            winning and mask are those after an input of one class.
    """
    n, nothing = grid.box.size, np.zeros(grid.box.size)
    errors = nothing if error is None else np.asarray(error, dtype=np.float64)
    frame = Frame(grid, np.ascontiguousarray(inputs, dtype=np.float64), errors)
    on = {j for i in range(n) for axes in (model.offset_axes[i], *model.jacobian_axes[i]) for j in axes}
    on |= set(range(n)) if gap_axes is None else set(gap_axes)
    own = tuple(sorted(on))
    others = tuple(j for j in range(n) if j not in on)
    shape, inside = layout(grid.cells, grid.periodic), winning.astype(np.uint8)
    sets = winning[:, None] if remembered is None else remembered.winning
    kind = np.zeros(len(inputs), np.int64) if remembered is None else remembered.kind
    tables = np.empty((sets.shape[1], table_size(shape, n)), np.int32)
    for c in range(len(tables)):
        count_holes(np.ascontiguousarray(sets[:, c]).astype(np.uint8), shape, n, tables[c])
    header = frame.header
    free = header.copy()
    for j in others:
        free[2 * n + j], free[3 * n + j] = -np.inf, np.inf
    factor, extra = np.full(grid.size, np.nan), np.full((grid.size, n), np.nan)
    search = _searcher(image(model.interval_kernel, model.jacobian_interval_kernel), gap)
    strides = np.array([int(np.prod(grid.cells[j + 1 :])) for j in range(n)])
    rest = _offsets(grid, others)
    cells = reduced_cells(grid, own)
    cells[:, list(others)] = 0
    if remembered is not None and remembered.layers is not None and own:
        cells = cells[np.isin(cells[:, own[-1]], remembered.layers)]
    flags = np.array([j in on for j in range(n)])
    about = (frame.inputs, kind, shape, tables, inside, mask)
    search(cells, rest, strides, flags, free, header, *about, factor, extra)
    return Margins(_rounded_down(factor), _rounded_down(extra))


def _rounded_down(values: Floats) -> NDArray[np.float32]:
    """Half the memory, never a larger number, whatever the shape (...)."""
    short = values.astype(np.float32)
    return np.where(short > values, np.nextafter(short, np.float32(0)), short)


def _offsets(grid: Grid, axes: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices along `axes` of all cells that differ along these alone: (k, nx)."""
    ranges = [np.arange(c) if j in axes else np.zeros(1, np.int64) for j, c in enumerate(grid.cells)]
    return np.stack([m.reshape(-1) for m in np.meshgrid(*ranges, indexing="ij")], axis=-1).astype(np.int64)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _fits(shape, n, table, lo, hi, header, work):  # type: ignore[no-untyped-def]
    """Whether the cells in which [lo, hi] can be measured lie in the set; `work` holds 2n numbers."""
    for j in range(n):
        first, last = to_cells(lo[j], hi[j], j, n, header)
        cells = shape[0, j]
        if shape[1, j] == 0:
            if first < 0 or last >= cells:
                return False
        elif last - first >= cells:
            first, last = 0, cells - 1
        else:
            turns = cells * (first // cells)
            first, last = first - turns, last - turns
        work[j], work[n + j] = first, last + 1
    total = 0
    for corner in range(1 << n):
        sign, index = 1, 0
        for j in range(n):
            if corner >> j & 1:
                sign = -sign
                index += work[j] * shape[3, j]
            else:
                index += work[n + j] * shape[3, j]
        total += sign * table[index]
    return total == 0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _grown(shape, n, table, lo, hi, by, size, header, work, spare):  # type: ignore[no-untyped-def]
    """Whether the box still fits when it grows by size * by on both sides, (n,)."""
    for j in range(n):
        spare[j], spare[n + j] = lo[j] - size * by[j], hi[j] + size * by[j]
    return _fits(shape, n, table, spare[:n], spare[n:], header, work)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _largest(shape, n, table, lo, hi, by, best, most, header, work, spare):  # type: ignore[no-untyped-def]
    """Largest size in (best, most] whose box fits, rounded down; `best` if none is larger by the resolution.

    A `best` below 0 says that nothing is known to fit, not even the box itself.
    """
    if best < 0.0:
        if not _fits(shape, n, table, lo, hi, header, work):
            return best
        best = 0.0
    step = max(best * (1.0 + RESOLUTION), most * 1e-9)
    if not _grown(shape, n, table, lo, hi, by, step, header, work, spare):
        return best
    if _grown(shape, n, table, lo, hi, by, most, header, work, spare):
        return most
    low, high = step, most
    while high > low * (1.0 + RESOLUTION):
        middle = np.sqrt(low * high)
        if _grown(shape, n, table, lo, hi, by, middle, header, work, spare):
            low = middle
        else:
            high = middle
    return low


@cache
def _searcher(image_of_box: Kernel, gap: Kernel) -> Any:
    """numba: the loop over cells; boxes are computed once for all cells that differ along axes that do not matter."""

    @kept
    def search(  # type: ignore[no-untyped-def]
        cells, rest, strides, own, free, header, inputs, kind, shape, tables, inside, mask, factor, extra
    ):  # fmt: skip
        n, count = cells.shape[1], inputs.shape[0]
        lo, hi, by = np.empty((count, n)), np.empty((count, n)), np.empty((count, n))
        box, ranges, low, high = np.empty((5, n)), np.empty((2, n)), np.empty(n), np.empty(n)
        work, spare, axis = np.empty(2 * n, np.int64), np.empty(2 * n), np.zeros(n)
        liked = np.zeros(n + 1, np.int64)
        for r in range(cells.shape[0]):
            cell_box(cells[r], n, free, box[0], box[1])
            for m in range(count):
                image_of_box(box[0], box[1], inputs[m], n, lo[m], hi[m], box[4])
                gap(box[0], box[1], inputs[m], ranges[0], ranges[1])
                for j in range(n):
                    lo[m, j] += ranges[0, j]
                    hi[m, j] += ranges[1, j]
                    by[m, j] = 0.5 * (ranges[1, j] - ranges[0, j])
            for t in range(rest.shape[0]):
                flat = 0
                for j in range(n):
                    flat += (cells[r, j] + rest[t, j]) * strides[j]
                if not inside[flat]:
                    continue
                for q in range(n + 1):  # the factor, then each axis alone
                    best = -1.0
                    for turn in range(-1, count):
                        m = liked[q] if turn < 0 else turn  # what served the last cell best rarely leaves more to find
                        if (turn == liked[q]) or not mask[flat, m >> 3] >> (m & 7) & 1:
                            continue
                        for j in range(n):
                            shift = header[n + j] * rest[t, j]
                            low[j], high[j] = lo[m, j] + shift, hi[m, j] + shift
                            axis[j] = by[m, j] if q == 0 else (1.0 if q - 1 == j else 0.0)
                        most = LARGEST_FACTOR - 1.0 if q == 0 else header[n + q - 1] * shape[0, q - 1]
                        found = _largest(shape, n, tables[kind[m]], low, high, axis, best, most, header, work, spare)
                        if found > best:
                            best, liked[q] = found, m
                        if best >= most:
                            break
                    if best >= 0.0 and q == 0:
                        factor[flat] = 1.0 + best
                    elif best >= 0.0:
                        extra[flat, q - 1] = best

    return search
