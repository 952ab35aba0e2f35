"""The finite abstraction of a plant: cells, inputs, and for each pair a box of cells that holds every successor.

That of a nominal model and its gap has whatever the symbolic structure allows tabulated on fewer axes.

Whether a box of cells lies wholly inside a set is one look-up in a summed-area table of the *holes*, the cells outside
it: the box lies inside exactly when its count is zero. A periodic axis is stored twice in a row, so that a box across
the seam is one contiguous range.

Kernels share the rows of a grid among threads: they release the interpreter lock and write disjoint rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.late import njit
from simgap.model.sampled import NominalModel
from simgap.synthesis.abstraction import post
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import Frame, Kernel, no_gap, reduced_cells, reduced_size, table_meta, table_post

T = TypeVar("T")
R = TypeVar("R")


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="synthesis")


def over_rows(work: Callable[[int, int], int], rows: int, threads: int) -> int:
    """Call `work(first, last)` over [0, rows) in chunks and add up what it returns; the sum is order-independent."""
    if threads <= 1 or rows < 2 * threads:
        return work(0, rows)
    chunk = -(-rows // (4 * threads))
    return sum(_pool(threads).map(lambda first: work(first, min(rows, first + chunk)), range(0, rows, chunk)))


def over_items(work: Callable[[T], R], items: Sequence[T], threads: int) -> list[R]:
    """Results of `work(item)` for every item; they must write to different places."""
    return list(map(work, items) if threads <= 1 else _pool(threads).map(work, items))


Counts = NDArray[np.int32]


def layout(cells: tuple[int, ...], periodic: tuple[int, ...]) -> Ints:
    """Describe an n-dimensional set of cells to the kernels of this module, n <= 4.

    Returns:
        (4, 4) int64: rows `cells`, `periodic` (0/1), `padded` table lengths, table `strides`; axis 0 first.
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


def count_holes(inside: NDArray[Any], shape: Ints, n: int) -> Counts:
    """Summed-area counts of the cells where `inside` (flat, row-major) is 0: the table of `layout(...)`, flat."""
    cells, periodic, lengths = shape[:3, :n]
    holes = (inside.reshape(cells) == 0).astype(np.int32)
    for j in np.flatnonzero(periodic):
        holes = np.concatenate([holes, holes], axis=j)
    counts = np.zeros(lengths, np.int32)
    np.cumsum(holes, axis=-1, dtype=np.int32, out=counts[(slice(1, None),) * n])
    for axis in range(n - 1):
        for before, layer in pairwise(np.moveaxis(counts, axis, 0)):
            layer += before
    return counts.reshape(-1)


@njit(cache=True, nogil=True)
def clip_boxes(shape, n, boxes, first, count, ok):  # type: ignore[no-untyped-def]
    """Bring boxes into the table's range, in place; `ok[i]` = 0 where box `first + i` leaves the grid.

    `boxes` is flat int32, 2n numbers a box (lower n, upper n cell indices). A periodic axis is shifted so that its
    lower index lies in [0, cells); a box at least a full turn wide becomes the whole axis.
    """
    ok[:count] = 1
    for j in range(n):
        cells = np.int32(shape[0, j])
        periodic = shape[1, j] == 1
        for i in range(count):
            at = 2 * n * (first + i) + j
            lo, hi = boxes[at], boxes[at + n]
            if not periodic:
                if lo < 0 or hi >= cells:
                    ok[i] = 0
            elif hi - lo >= cells:
                boxes[at], boxes[at + n] = 0, cells - 1
            elif lo < 0 or lo >= cells:
                turns = cells * (lo // cells)
                boxes[at], boxes[at + n] = lo - turns, hi - turns


@njit(cache=True, nogil=True)
def drop_boxes_with_holes(table, shape, n, boxes, first, count, ok):  # type: ignore[no-untyped-def]
    """Set `ok[i]` = 0 for every clipped box that holds a hole: 2, 4, 8 or 16 loads a box. Others stay as they are.

    One call handles a batch: a call per box would cost more in argument passing than the look-up itself.
    """
    if n == 2:
        s0 = np.uint64(shape[3, 0])
        for i in range(count):
            at = 4 * (first + i)
            if ok[i]:
                a, b = np.uint64(boxes[at]) * s0, np.uint64(boxes[at + 2] + 1) * s0
                c, d = np.uint64(boxes[at + 1]), np.uint64(boxes[at + 3] + 1)
                if table[b + d] - table[a + d] != table[b + c] - table[a + c]:
                    ok[i] = 0
    elif n == 3:
        s0, s1 = np.uint64(shape[3, 0]), np.uint64(shape[3, 1])
        for i in range(count):
            at = 6 * (first + i)
            if ok[i]:
                a, b = np.uint64(boxes[at]) * s0, np.uint64(boxes[at + 3] + 1) * s0
                c, d = np.uint64(boxes[at + 1]) * s1, np.uint64(boxes[at + 4] + 1) * s1
                e, f = np.uint64(boxes[at + 2]), np.uint64(boxes[at + 5] + 1)
                upper = table[b + d + f] - table[a + d + f] - table[b + c + f] + table[a + c + f]
                lower = table[b + d + e] - table[a + d + e] - table[b + c + e] + table[a + c + e]
                if upper != lower:
                    ok[i] = 0
    elif n == 4:
        s0, s1, s2 = np.uint64(shape[3, 0]), np.uint64(shape[3, 1]), np.uint64(shape[3, 2])
        for i in range(count):
            at = 8 * (first + i)
            if ok[i]:
                total = np.int32(0)
                e, f = np.uint64(boxes[at + 3]), np.uint64(boxes[at + 7] + 1)
                c, d = np.uint64(boxes[at + 2]) * s2, np.uint64(boxes[at + 6] + 1) * s2
                for a in (np.uint64(boxes[at + 4] + 1) * s0, np.uint64(boxes[at]) * s0):
                    total = -total
                    for b in (np.uint64(boxes[at + 5] + 1) * s1, np.uint64(boxes[at + 1]) * s1):
                        q = a + b
                        square = table[q + d + f] - table[q + d + e] - table[q + c + f] + table[q + c + e]
                        total = square - total
                if total != 0:
                    ok[i] = 0
    else:
        for i in range(count):
            if ok[i] and table[boxes[2 * (first + i)]] != table[boxes[2 * (first + i) + 1] + 1]:
                ok[i] = 0


MAX_AXES = 4


@dataclass(frozen=True, eq=False)
class Abstraction:
    """Cells x inputs -> boxes of cells, evaluated when asked for and never stored.

    Attributes:
        grid: cells of X, at most 4 axes.
        inputs: the finite input set U, (M, nu).
        post: compiled function of `post.POST`.
        meta, data, table: flat arrays that `post` reads.
        axes: for each dimension i, the state axes on which the offset f_i(x, u) - x_i and its spread depend.
        error: bound of the measurement error that the boxes account for, (nx,).
        group: neighbouring cells over which `post` may bound the gap at once, 1 if that would save nothing.
        swept: cells that the path between samples may touch, for each input; None where it does not matter.
    """

    grid: Grid
    inputs: Floats
    post: Any
    meta: Ints
    data: Floats
    table: NDArray[np.int32]
    axes: tuple[tuple[int, ...], ...]
    error: Floats
    swept: SweptCells | None = None
    group: int = 1

    def __post_init__(self) -> None:
        if self.grid.box.size > MAX_AXES:
            raise UserError(f"synthesis covers at most {MAX_AXES} states, not {self.grid.box.size}")
        if self.inputs.ndim != 2 or len(self.inputs) == 0:
            raise UserError("the input set is empty", remedy="Give at least one input value per input")

    @property
    def shape(self) -> Ints:
        """The grid as the kernels read it (`layout`): (4, 4)."""
        return layout(self.grid.cells, self.grid.periodic)

    def paths(self) -> Abstraction:
        """Boxes of the cells that the path of each input may touch, as those of its successors; needs `swept`."""
        assert self.swept is not None
        size = np.array(self.grid.cells, np.int32)  # no box is farther from its cell than twice the grid
        ends = np.maximum(self.swept.lower, -2 * size), np.minimum(self.swept.upper, 2 * size)
        axes = ((self.swept.axis,),) * size.size
        meta, _ = table_meta(self.grid, len(self.inputs), axes)
        table = np.moveaxis(np.stack(ends, axis=-1), 2, 0).reshape(-1)
        return replace(self, post=table_post(), meta=meta, table=table, axes=axes, swept=None, group=1)

    def boxes(self, cells: Ints, first: int = 0, last: int | None = None) -> NDArray[np.int32]:
        """Boxes of successors, not wrapped: flat cells (n,) -> (n, last - first, 2, nx) lower and upper indices."""
        last = len(self.inputs) if last is None else last
        k = np.stack(np.unravel_index(cells, self.grid.cells), axis=-1).astype(np.int64)
        out = np.zeros((len(k), last - first, 2, self.grid.box.size), dtype=np.int32)
        _boxes(self.post, np.ascontiguousarray(k), first, last, self.meta, self.data, self.table, out)
        return out


@njit(cache=True, nogil=True)
def _boxes(post, k, first, last, meta, data, table, out):  # type: ignore[no-untyped-def]
    for i in range(k.shape[0]):
        post(k[i].ctypes, 1, 1, first, last, meta.ctypes, data.ctypes, table.ctypes, out[i].ctypes)


Axes = tuple[tuple[int, ...], ...]
PAIRS = 1 << 18
"""Cells and inputs whose gap is bounded in one call."""
GROUP = 8
"""Cells whose gap is bounded at once before a pair is looked at by itself."""


def nominal_abstraction(
    model: NominalModel,
    grid: Grid,
    inputs: Floats,
    gap: Kernel | GapFunction | None = None,
    gap_axes: Sequence[int] | None = None,
    error: ArrayLike | None = None,
) -> Abstraction:
    """Abstraction of `x+ in f(x, u) + [lo(x, u), hi(x, u)]`, rigorously rounded outward.

    Args:
        model: the nominal map f with its interval kernels and structure.
        grid: cells of the states that the controller may measure.
        inputs: U, (M, nu).
        gap: a gap function, or its kernel (`GapFunction.kernel()`), None for f alone.
        gap_axes: state axes on which the gap's bounds depend; all when None.
        error: bound of |measured - true| per state, (nx,); cells are then cells of the measurement. The true state is
            assumed to lie in the grid's box, which every successor box guarantees.

    Raises:
        UserError: when model, grid and error differ in dimension.
    """
    errors = np.zeros(model.nx) if error is None else np.asarray(error, dtype=np.float64)
    if grid.box.size != model.nx or errors.shape != (model.nx,):
        raise UserError(f"a model of {model.nx} states got a grid of {grid.box.size} and {errors.size} errors")
    u = np.ascontiguousarray(inputs, dtype=np.float64)
    frame = Frame(grid, u, errors)
    own = _axes_of(model)
    everything = tuple(range(model.nx))
    with_gap: Axes = own
    if gap is not None:
        of_gap = everything if gap_axes is None else tuple(gap_axes)
        with_gap = tuple(tuple(sorted({*axes, *of_gap})) for axes in own)
    if _fits(grid, len(u), with_gap):
        return _integer_tables(model, frame, gap, with_gap)
    kernel = no_gap if gap is None else gap.kernel() if isinstance(gap, GapFunction) else gap
    if _fits(grid, len(u), own):
        meta, data = frame.arrays(own, _tables(model, frame, None, own))
        own_post = post.tabulated_post(kernel)
    else:
        meta, data = frame.arrays(tuple(() for _ in own), None)
        own_post = post.direct_post(model.interval_kernel, model.jacobian_interval_kernel, kernel)
    return Abstraction(grid, u, own_post, meta, data, np.zeros(1, np.int32), with_gap, errors, group=GROUP)


def _axes_of(model: NominalModel) -> Axes:
    """For each dimension, the state axes on which its offset and its slopes depend."""
    return tuple(tuple(sorted(frozenset(model.offset_axes[i]).union(*model.jacobian_axes[i]))) for i in range(model.nx))


def is_tabulated(model: NominalModel, grid: Grid, inputs: int) -> bool:
    """True if the model is read from tables; else it is evaluated for every pair of cell and input."""
    return _fits(grid, inputs, _axes_of(model))


def _fits(grid: Grid, inputs: int, axes: Axes) -> bool:
    """True if tables on these axes stay within a few numbers per cell."""
    return sum(reduced_size(grid, own) for own in axes) * inputs <= 4 * grid.size + 1_000_000


def _tables(model: NominalModel, frame: Frame, gap: Kernel | GapFunction | None, axes: Axes) -> Floats:
    """Offsets of each dimension from the cell's centre, (lower, upper) per reduced cell and input, flat.

    Dimensions on the same axes have the same cells: the model and the gap are evaluated once for them.
    """
    parts: dict[int, Floats] = {}
    for own in dict.fromkeys(axes):
        same = [i for i, other in enumerate(axes) if other == own]
        for i, out in zip(same, _together(model, frame, gap, own, same), strict=True):
            parts[i] = out.reshape(-1)
    return np.concatenate([parts[i] for i in range(model.nx)])


def _together(
    model: NominalModel, frame: Frame, gap: Kernel | GapFunction | None, own: tuple[int, ...], same: list[int]
) -> Floats:
    """Offsets of the dimensions `same` on the cells over the axes `own`: (len(same), cells, M, 2)."""
    cells, which = reduced_cells(frame.grid, own), np.array(same)
    out = np.empty((len(same), len(cells), len(frame.inputs), 2))
    flags = np.array([j in own for j in range(model.nx)])
    if any(axes for row in model.jacobian_axes for axes in row):
        fill = post.table_filler(model.interval_kernel, model.jacobian_interval_kernel)
        fill(cells, which, flags, frame.header, frame.inputs, out)
    else:
        post.fill_affine(cells, which, flags, frame.header, *_affine(model, frame), out)
    if isinstance(gap, GapFunction):
        step = max(1, PAIRS // len(frame.inputs))
        for first in range(0, len(cells), step):
            _add_bounds(gap, frame, cells[first : first + step], which, out[:, first : first + step])
    elif gap is not None:
        post.gap_adder(gap)(cells, which, frame.header, frame.inputs, out)
    return out


def _affine(model: NominalModel, frame: Frame) -> tuple[Floats, Floats, Floats]:
    """A point, and for each input f there (M, nx, 2) and df/dx (M, nx, nx, 2), which is the same everywhere."""
    start, n = 0.5 * (frame.grid.box.lo + frame.grid.box.hi), model.nx
    points = [(start, start, u, u) for u in frame.inputs]
    value = [np.array(model.interval_kernel(*p), dtype=np.float64) for p in points]
    slope = [np.array(model.jacobian_interval_kernel(*p), dtype=np.float64) for p in points]
    return start, np.stack(value), np.stack(slope).reshape(-1, n, n, 2)


def _add_bounds(gap: GapFunction, frame: Frame, cells: Ints, which: Ints, out: Floats) -> None:
    """Add the gap's bounds over cells (k, nx) to out (dimensions, k, M, 2)."""
    lo, hi = np.empty(cells.shape), np.empty(cells.shape)
    post.cell_boxes(cells, frame.header, lo, hi)
    count = len(frame.inputs)
    found = gap.box_bounds(
        np.repeat(lo, count, axis=0), np.repeat(hi, count, axis=0), np.tile(frame.inputs, (len(cells), 1))
    )
    for side, bound in enumerate(found):
        out[..., side] += np.moveaxis(bound.reshape(len(cells), count, -1), 2, 0)[which]


def _integer_tables(model: NominalModel, frame: Frame, gap: Kernel | GapFunction | None, axes: Axes) -> Abstraction:
    offsets = _tables(model, frame, gap, axes).reshape(-1, len(frame.inputs), 2)
    table = np.empty(offsets.shape, np.int32)
    first = 0
    for i, own in enumerate(axes):
        rows = slice(first, first + reduced_size(frame.grid, own))
        post.whole_cells(offsets[rows], i, model.nx, frame.header, table[rows])
        first = rows.stop
    meta, _ = table_meta(frame.grid, len(frame.inputs), axes)
    return Abstraction(frame.grid, frame.inputs, table_post(), meta, frame.header, table.reshape(-1), axes, frame.error)
