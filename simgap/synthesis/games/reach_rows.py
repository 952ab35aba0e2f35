"""Reach-while-avoid on bit rows: 64 cells a machine word where no offset depends on some axis (`row_moves`).

A node is a cell and, where the plant remembers, the class of the input before. Input m takes a node (k, c) into the box
of (k, m) in class c and to the class of m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.geometry import Grid
from simgap.late import njit
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import reduced_cells, reduced_size
from simgap.synthesis.abstraction.swept import SweptCells
from simgap.synthesis.games.erosion import BoxErosion
from simgap.synthesis.games.row_moves import Moves, moves_of, words_of_a_row
from simgap.synthesis.games.row_waves import place, settle, spread, stage_size
from simgap.synthesis.games.threads import over_items, over_rows
from simgap.synthesis.input_sets import packed_width

COMPARED = 256


@njit(cache=True, nogil=True)
def pack_rows(cells, base, stride, count, bits):  # type: ignore[no-untyped-def]
    """Pack flags of cells (flat uint8) into rows (rows, words) uint64; cell j of a row is `base[row] + j stride`."""
    for r in range(base.size):
        for w in range(bits.shape[1]):
            bits[r, w] = np.uint64(0)
        for j in range(count):
            if cells[base[r] + j * stride]:
                bits[r, j >> 6] |= np.uint64(1) << np.uint64(j & 63)


def smallest_boxes(lower: NDArray[np.int32], upper: NDArray[np.int32]) -> Bools:
    """Inputs without most of those whose boxes hold another one's: what any input wins, one of these wins.

    lower, upper (layers, M, k), one or more boxes beside each other -> (layers, M). Every box is held against the
    `COMPARED` smallest that are left, so that it takes a time linear in the inputs.
    """
    kept = np.zeros(lower.shape[:2], np.bool_)
    order = np.argsort((upper.astype(np.int64) - lower).sum(axis=2), axis=1, kind="stable")
    _smallest(lower, upper, order, kept)
    return kept


@njit(cache=True, nogil=True)
def _smallest(lower, upper, order, kept):  # type: ignore[no-untyped-def]
    smallest = np.zeros(COMPARED, np.int64)
    for layer in range(lower.shape[0]):
        number = 0
        for m in order[layer]:
            found = False
            for i in range(number):
                o, inside = smallest[i], True
                for j in range(lower.shape[2]):
                    if lower[layer, o, j] < lower[layer, m, j] or upper[layer, o, j] > upper[layer, m, j]:
                        inside = False
                        break
                if inside:
                    found = True
                    break
            if not found:
                kept[layer, m] = True
                if number < COMPARED:
                    smallest[number] = m
                    number += 1


Bits = NDArray[np.uint64]
ENTRIES = 1 << 16
"""Words of cells found with an input that there is room for at first, for each thread."""


class Levels:
    """The sets of nodes while they grow.

    Attributes:
        news: (classes, slabs) whether a slab won cells at the last level.
    """

    def __init__(
        self, moves: Moves, classes: int, goal: Bits, allowed: Bits, clear: Bits, threads: int, every: bool
    ) -> None:
        """From the target and the free cells (rows, words), and the free cells eroded by swept boxes (`spread`)."""
        rows, words, widest = moves.size.tolist()
        flat = goal.reshape(-1, rows * words)
        self._moves, self._clear, self._threads, self._every = moves, clear, threads, every
        self._won = np.stack([flat] * classes)
        self._todo = np.concatenate([allowed.reshape(flat.shape) & ~flat] * classes)
        self._made = np.zeros((len(moves.block_class), rows * words), np.uint64)
        self.news = np.stack([flat.any(axis=1)] * classes).astype(np.uint8)
        self._fresh = np.zeros((threads, *self._todo.shape), np.uint64)
        self._ends = np.zeros((threads, self._todo.size if every else 1), np.int64)
        self._count = np.zeros((threads, 1), np.int64)
        self._entries = np.empty((threads, ENTRIES if every else 1, 2), np.uint64)
        self._stage = np.zeros((threads, *stage_size(rows, words, widest)), np.uint64)
        self._runs, self._line = np.zeros((threads, 2, rows), np.int64), np.zeros((threads, rows * words), np.uint64)

    def _make_room(self, entries: int) -> None:
        """Room for entries (next one and move, cells) of every thread; those that are there stay."""
        wider = np.empty((self._threads, entries, 2), np.uint64)
        wider[:, : self._entries.shape[1]] = self._entries
        self._entries = wider

    def spread(self) -> None:
        """Find what can be won now."""
        self._count[:] = 0
        self._ends[:] = 0
        left = dict(enumerate(range(self._threads)))
        while left:
            found = dict(zip(left, over_items(partial(self._spread, left), [*left], self._threads), strict=True))
            left = {worker: block for worker, block in found.items() if block >= 0}
            if left:
                ends = [self._moves.job_moves[self._moves.block_jobs[b : b + 2]] for b in left.values()]
                most = max(int(e[1] - e[0]) for e in ends) * self._line.shape[1]
                self._make_room(max(int(self._count.max()) + most, 2 * self._entries.shape[1]))

    def _spread(self, blocks: dict[int, int], worker: int) -> int:
        own = self._fresh, self._ends, self._entries, self._count
        space = (a[worker] for a in (self._stage, self._runs, self._line, *own))
        sets = self._moves, self._won, self._todo, self.news, self._made, self._clear
        return int(spread(*sets, *space, self._every, self._threads, blocks[worker]))

    def settle(self, level: int, base: Ints, stride: int, order: Ints, into: tuple[NDArray[Any], ...]) -> None:
        """Win it: value (cells, classes), mask (cells, classes, bytes) and chosen (cells, classes) are written.

        Chosen is the first of the inputs in `order` (M,), or nothing where that is empty.
        """
        placed = np.empty((self._threads, int(self._count.max()), 2), np.uint64)
        over_items(
            lambda w: place(self._entries[w], self._count[w, 0], self._ends[w], placed[w]),
            range(self._threads),
            self._threads,
        )
        found = self._moves, self._fresh, self._ends, placed, self._every
        sets = self._won, self._todo, self.news
        work = partial(settle, *found, *sets, base, stride, level, order, *into)
        self.news[:] = 0
        over_rows(work, self._line.shape[1], self._threads)


MAX_SHAPE_CELLS = 4_000_000_000  # bits: 500 MB of free cells eroded by swept boxes
MAX_BOXES = 40_000_000


@dataclass(frozen=True, eq=False)
class RowSystem:
    """All boxes of an abstraction whose offsets do not depend on the bit axis.

    Attributes:
        bit_axis: the axis whose cells share machine words, `count` of them; row_axes: the others, at most 3; the last
            one is idle too where `slab_rows` is more than 1.
        lengths, periodic: (3,) of the row axes, padded with 1 and 0 in front.
        slab_rows: rows that lie below each other with the same boxes.
        base: (rows,) flat index of a row's first cell; stride: from one cell of a row to the next.
        layer: (rows,) which boxes a row uses.
        rel, extent: (layers, M, 4) int32 lower offsets and sizes of the boxes along the row axes and the bit axis.
        swept, swept_of, swept_shapes: the same for the swept box of each input: (layers, M, 4), which of the sizes
            (k, 4); nothing where it does not matter.
    """

    bit_axis: int
    count: int
    row_axes: tuple[int, ...]
    lengths: Ints
    periodic: Ints
    slab_rows: int
    base: Ints
    stride: int
    layer: NDArray[np.int32]
    rel: NDArray[np.int32]
    extent: NDArray[np.int32]
    swept: NDArray[np.int32]
    swept_of: NDArray[np.int32]
    swept_shapes: Ints

    @staticmethod
    def of(abstraction: Abstraction) -> RowSystem | None:
        """The row system, or None where the structure does not allow one or it would not pay."""
        grid, inputs = abstraction.grid, len(abstraction.inputs)
        used = sorted(set().union(*abstraction.axes))
        idle = [j for j in range(grid.box.size) if j not in used and j not in grid.periodic]
        if not idle or reduced_size(grid, tuple(used)) * inputs > min(MAX_BOXES, 4 * grid.size + 1_000_000):
            return None
        bit_axis = max(idle, key=lambda j: grid.cells[j])
        below = max((j for j in idle if j != bit_axis), key=lambda j: grid.cells[j], default=None)
        others = [j for j in range(grid.box.size) if j not in (bit_axis, below)]
        row_axes = (*others, *(() if below is None else (below,)))
        slab_rows = 1 if below is None else grid.cells[below]
        if grid.size // grid.cells[bit_axis] // slab_rows * inputs > MAX_BOXES:
            return None
        rel, extent = _offsets(abstraction, tuple(used), [*row_axes, bit_axis])
        swept, length = _swept_offsets(abstraction.swept, grid, tuple(used), [*row_axes, bit_axis], rel.shape[:2])
        swept_shapes, swept_of = np.unique(length.reshape(-1, 4), axis=0, return_inverse=True)
        if len(swept_shapes) * grid.size > MAX_SHAPE_CELLS:
            return None
        missing = 3 - len(row_axes)
        lengths = np.array([1] * missing + [grid.cells[j] for j in row_axes])
        strides = np.cumprod([1, *grid.cells[:0:-1]])[::-1]
        index = np.stack(np.unravel_index(np.arange(int(lengths.prod())), tuple(lengths)), axis=-1)[:, missing:]
        layer = np.zeros(len(index), np.int64)
        for j in used:
            layer = layer * grid.cells[j] + index[:, row_axes.index(j)]
        return RowSystem(
            bit_axis=bit_axis,
            count=grid.cells[bit_axis],
            row_axes=row_axes,
            lengths=lengths,
            periodic=np.array([0] * missing + [int(j in grid.periodic) for j in row_axes]),
            slab_rows=slab_rows,
            base=index @ strides[list(row_axes)],
            stride=int(strides[bit_axis]),
            layer=layer.astype(np.int32),
            rel=rel,
            extent=extent,
            swept=swept,
            swept_of=swept_of.reshape(swept.shape[:2]).astype(np.int32),
            swept_shapes=swept_shapes.astype(np.int64),
        )

    def worth_trying(self, kind: Ints) -> Bools:
        """The inputs that can win a node first, (layers, M): no input of the same class (M,) has smaller boxes."""
        of_input = np.broadcast_to(kind[None, :, None], (*self.rel.shape[:2], 1))
        lower: list[Ints] = [of_input, self.rel.astype(np.int64)]
        upper: list[Ints] = [of_input, lower[1] + self.extent]
        if len(self.swept):
            lower.append(self.swept.astype(np.int64))
            upper.append(lower[2] + self.swept_shapes[self.swept_of])
        low, high = (np.concatenate(side, axis=2).astype(np.int32) for side in (lower, upper))
        return smallest_boxes(low, high)


def _offsets(abstraction: Abstraction, used: tuple[int, ...], order: list[int]) -> tuple[NDArray[np.int32], ...]:
    """Lower offsets and extents (layers, M, 4) in the given order of axes, padded in front; wide boxes are cut."""
    grid = abstraction.grid
    cells = reduced_cells(grid, used)
    flat = np.ravel_multi_index(tuple(cells.T), grid.cells)
    size, wraps = np.array(grid.cells), np.isin(np.arange(grid.box.size), grid.periodic)
    lower = np.zeros((len(cells), len(abstraction.inputs), 4), np.int32)
    extent = np.ones_like(lower)
    for first in range(0, len(flat), 256):
        block = abstraction.boxes(flat[first : first + 256])
        k = cells[first : first + 256, None, :]
        low, high = (block[:, :, side].astype(np.int64) - k for side in (0, 1))
        turns = np.where(wraps, size * (low // size), 0)
        low, high = low - turns, high - turns
        low, high = np.maximum(low, -2 * size), np.minimum(high, 2 * size)  # beyond any cell of the grid either way
        whole = wraps & (high - low >= size)
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


def with_common_sweeps(systems: Sequence[RowSystem]) -> list[RowSystem]:
    """The systems with sizes of swept boxes that are counted through all of them."""
    own = [s.swept_shapes[s.swept_of] for s in systems]
    shapes, place = np.unique(np.concatenate([o.reshape(-1, 4) for o in own]), axis=0, return_inverse=True)
    each = np.split(place.reshape(-1), np.cumsum([o.size // 4 for o in own])[:-1])
    return [
        replace(s, swept_shapes=shapes, swept_of=p.reshape(s.swept_of.shape).astype(np.int32))
        for s, p in zip(systems, each, strict=True)
    ]


def reach_by_rows(
    systems: Sequence[RowSystem],
    kind: Ints,
    target: Bools,
    free: Bools,
    threads: int,
    masks: bool,
    order: Ints | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.int16]]:
    """Levels and admissible inputs of nodes.

    Args:
        systems: boxes after a previous input of each class, over common sizes of swept boxes.
        kind: (M,) class of each input.
        target, free: (cells,); target cells that are not free do not count.
        threads: slabs are shared among this many threads; the result does not depend on it.
        masks: whether to record the inputs.
        order: inputs (M,) of which the first admissible one alone is recorded, whatever `masks` says.

    Returns:
        value (cells, classes), mask (cells, classes, bytes), without masks (cells, classes, 0), and that one input
        (cells, classes), -1 for none, without an order (0, 0).
    """
    s, classes = systems[0], len(systems)
    every, one = masks or order is not None, np.empty(0, np.int64) if order is None else order
    moves = moves_of(systems, kind, None if every else [own.worth_trying(kind) for own in systems])
    words = words_of_a_row(systems)
    goal, allowed = (np.zeros((len(s.base), words), np.uint64) for _ in range(2))
    pack_rows((target & free).astype(np.uint8), s.base, s.stride, s.count, goal)
    pack_rows(free.astype(np.uint8), s.base, s.stride, s.count, allowed)
    value = np.full((free.size, classes), -1, np.int32)
    value[target & free] = 0
    mask = np.zeros((free.size, classes, packed_width(len(kind)) if masks and order is None else 0), np.uint8)
    chosen = np.full((0, 0) if order is None else value.shape, -1, np.int16)
    levels = Levels(moves, classes, goal, allowed, _clear(s, allowed), threads, every)
    level = 0
    while levels.news.any():
        level += 1
        levels.spread()
        levels.settle(level, s.base, s.stride, one, (value, mask, chosen))
    return value, mask, chosen


def _clear(s: RowSystem, allowed: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The free cells eroded by each swept box, flat (shapes, rows, words) with an empty row in front and behind."""
    flat = np.zeros((len(s.swept_shapes) * len(allowed) + 2) * allowed.shape[1], np.uint64)
    clear = flat[allowed.shape[1] : flat.size - allowed.shape[1]].reshape(-1, *allowed.shape)
    erode = BoxErosion(s.lengths, s.periodic, s.swept_shapes)
    erode(allowed, clear, np.zeros(clear.shape[:2], np.uint8))
    return flat
