"""Reach-while-avoid on bit rows (see `erosion`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simgap.geometry import Grid
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.bit_rows import pack_rows, smallest_boxes
from simgap.synthesis.bits import packed_width
from simgap.synthesis.box_erosion import BoxErosion, dilate
from simgap.synthesis.erosion import predecessors, record
from simgap.synthesis.swept import SweptCells
from simgap.synthesis.tables import reduced_cells, reduced_size
from simgap.synthesis.threads import over_rows

Ints = NDArray[np.int64]
MAX_SHAPE_CELLS = 4_000_000_000  # bits: 500 MB of eroded sets
MAX_BOXES = 40_000_000


@dataclass(frozen=True, eq=False)
class RowSystem:
    """All boxes of an abstraction whose offsets do not depend on the bit axis.

    Attributes:
        bit_axis: the axis whose cells share machine words; row_axes: the others, at most 3.
        lengths, periodic: (3,) of the row axes, padded with 1 and 0.
        base: (rows,) flat index of a row's first cell; stride: from one cell of a row to the next.
        layer: (rows,) which boxes a row uses.
        rel: (layers, M, 4) int32 lower offsets along the row axes and the bit axis.
        shape_of: (layers, M) int16 which of `shapes` (k, 4), the box's extent along the same axes.
        keep, number: (layers, M), (layers,) the inputs that can win a cell first (`erosion.smallest_boxes`).
        swept, swept_of, swept_shapes: as rel, shape_of, shapes, for the swept box of each input; no shapes where it
            does not matter.
        reach: (2, 3) least lower and largest upper offset along the row axes.
    """

    bit_axis: int
    row_axes: tuple[int, ...]
    lengths: Ints
    periodic: Ints
    base: Ints
    stride: int
    layer: NDArray[np.int32]
    rel: NDArray[np.int32]
    shape_of: NDArray[np.int16]
    shapes: Ints
    keep: NDArray[np.int32]
    number: NDArray[np.int32]
    swept: NDArray[np.int32]
    swept_of: NDArray[np.int16]
    swept_shapes: Ints
    reach: Ints

    @staticmethod
    def of(abstraction: Abstraction) -> RowSystem | None:
        """The row system, or None where the structure does not allow one or it would not pay."""
        grid, inputs = abstraction.grid, len(abstraction.inputs)
        used = sorted(set().union(*abstraction.axes))
        idle = [j for j in range(grid.box.size) if j not in used and j not in grid.periodic]
        if not idle or reduced_size(grid, tuple(used)) * inputs > min(MAX_BOXES, 4 * grid.size + 1_000_000):
            return None
        bit_axis = max(idle, key=lambda j: grid.cells[j])
        row_axes = tuple(j for j in range(grid.box.size) if j != bit_axis)
        rel, extent = _offsets(abstraction, tuple(used), [*row_axes, bit_axis])
        swept, length = _swept_offsets(abstraction.swept, grid, tuple(used), [*row_axes, bit_axis], rel.shape[:2])
        shapes, shape_of = np.unique(extent.reshape(-1, 4), axis=0, return_inverse=True)
        swept_shapes, swept_of = np.unique(length.reshape(-1, 4), axis=0, return_inverse=True)
        if (len(shapes) + len(swept_shapes)) * grid.size > MAX_SHAPE_CELLS:
            return None
        keep, number = np.zeros(rel.shape[:2], np.int32), np.zeros(len(rel), np.int32)
        both = np.concatenate([rel, swept], axis=2) if len(swept) else rel
        smallest_boxes(both, np.concatenate([extent, length], axis=2) if len(swept) else extent, keep, number)
        missing = 3 - len(row_axes)
        lengths = np.array([1] * missing + [grid.cells[j] for j in row_axes])
        strides = np.cumprod([1, *grid.cells[:0:-1]])[::-1]
        index = np.stack(np.unravel_index(np.arange(int(lengths.prod())), tuple(lengths)), axis=-1)[:, missing:]
        layer = np.zeros(len(index), np.int64)
        for j in used:
            layer = layer * grid.cells[j] + index[:, row_axes.index(j)]
        return RowSystem(
            bit_axis=bit_axis,
            row_axes=row_axes,
            lengths=lengths,
            periodic=np.array([0] * missing + [int(j in grid.periodic) for j in row_axes]),
            base=index @ strides[list(row_axes)],
            stride=int(strides[bit_axis]),
            layer=layer.astype(np.int32),
            rel=rel,
            shape_of=shape_of.reshape(rel.shape[:2]).astype(np.int16),
            shapes=shapes.astype(np.int64),
            keep=keep,
            number=number,
            swept=swept,
            swept_of=swept_of.reshape(swept.shape[:2]).astype(np.int16),
            swept_shapes=swept_shapes.astype(np.int64),
            reach=np.stack([rel[..., :3].min((0, 1)), (rel + extent - 1)[..., :3].max((0, 1))]).astype(np.int64),
        )


def _offsets(abstraction: Abstraction, used: tuple[int, ...], order: list[int]) -> tuple[NDArray[np.int32], ...]:
    """Lower offsets and extents (layers, M, 4) in the given order of axes, padded in front; wide boxes are cut."""
    grid = abstraction.grid
    cells = reduced_cells(grid, used)
    flat = np.ravel_multi_index(tuple(cells.T), grid.cells)
    size = np.array(grid.cells)
    lower = np.zeros((len(cells), len(abstraction.inputs), 4), np.int32)
    extent = np.ones_like(lower)
    for first in range(0, len(flat), 256):
        block = abstraction.boxes(flat[first : first + 256])
        k = cells[first : first + 256, None, :]
        low, high = block[:, :, 0] - k, block[:, :, 1] - k
        low, high = np.maximum(low, -2 * size), np.minimum(high, 2 * size)  # beyond any cell of the grid either swept
        whole = (high - low >= size) & np.isin(np.arange(grid.box.size), grid.periodic)
        low, high = np.where(whole, 0, low), np.where(whole, size - 1, high)
        lower[first : first + 256, :, -len(order) :] = low[..., order]
        extent[first : first + 256, :, -len(order) :] = (high - low + 1)[..., order]
    return lower, extent


def _swept_offsets(
    swept: SweptCells | None, grid: Grid, used: tuple[int, ...], order: list[int], shape: tuple[int, ...]
) -> tuple[NDArray[np.int32], ...]:
    """Lower offsets and extents of the swept boxes, laid out as `_offsets`; (0, M, 4) without a swept."""
    lower = np.zeros((shape[0] if swept is not None else 0, shape[1], 4), np.int32)
    extent = np.ones_like(lower)
    if swept is not None:
        low, high = swept.at(reduced_cells(grid, used), grid)
        lower[..., -len(order) :] = low[..., order]
        extent[..., -len(order) :] = (high - low + 1)[..., order]
    return lower, extent


def _clear(system: RowSystem, allowed: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The free cells eroded by each swept box, (shapes, rows, words)."""
    clear = np.zeros((len(system.swept_shapes), *allowed.shape), np.uint64)
    BoxErosion(system.lengths, system.periodic, system.swept_shapes)(
        allowed, clear, np.zeros(clear.shape[:2], np.uint8)
    )
    return clear


def reach_by_rows(
    abstraction: Abstraction,
    system: RowSystem,
    target: NDArray[np.uint8],
    free: NDArray[np.uint8],
    threads: int,
    masks: bool,
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Levels and admissible inputs: flags (cells,) -> value (cells,), mask (cells, bytes), (cells, 0) without masks."""
    grid = abstraction.grid
    rows, count = len(system.base), grid.cells[system.bit_axis]
    words = (count + 63) // 64
    won, allowed, fresh = (np.zeros((rows, words), np.uint64) for _ in range(3))
    pack_rows(target, system.base, system.stride, count, won)
    pack_rows(free, system.base, system.stride, count, allowed)
    value = np.where(target, 0, -1).astype(np.int32)
    mask = np.zeros((grid.size, packed_width(len(abstraction.inputs)) if masks else 0), np.uint8)
    eroded = np.zeros((len(system.shapes), rows, words), np.uint64)
    grew = np.zeros((len(system.shapes), rows), np.uint8)
    news = np.asarray(won.any(axis=1), np.uint8)
    axes = (system.lengths, system.periodic)
    erode = BoxErosion(*axes, system.shapes)
    boxes = (system.layer, system.rel, system.shape_of, eroded, system.swept, system.swept_of, _clear(system, allowed))
    level = 0
    while news.any():
        level += 1
        erode(won, eroded, grew, threads)
        near = dilate(news, *axes, system.reach[0], system.reach[1])
        trial = (system.keep, system.number, grew, near, won, allowed, fresh)
        over_rows(partial(predecessors, *axes, *boxes, *trial), rows, threads)
        over_rows(
            partial(record, *axes, *boxes, won, fresh, system.base, system.stride, level, value, mask), rows, threads
        )
        news = np.asarray(fresh.any(axis=1), np.uint8)
    return value, mask
