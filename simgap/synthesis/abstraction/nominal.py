"""Abstraction of a nominal model and its gap, with whatever the symbolic structure allows tabulated on fewer axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.model.sampled import NominalModel
from simgap.synthesis.abstraction import post
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import Frame, Kernel, no_gap, reduced_cells, reduced_size

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
    meta, _ = post.table_meta(frame.grid, len(frame.inputs), axes)
    return Abstraction(
        frame.grid, frame.inputs, post.table_post(), meta, frame.header, table.reshape(-1), axes, frame.error
    )
