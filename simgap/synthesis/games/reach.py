"""Reach-while-avoid: the value function is the level at which a cell is won, counted in worst-case steps to the target.

Level 0 is the target. A free cell is won at level l when some input's box lies wholly in the cells of levels below l;
the inputs that do so at that moment are exactly those that go down a level, and they are the admissible ones. Where
the plant remembers the class of the previous input, a node is a cell and that class: input m takes the node (k, c) into
the box of (k, m) in class c, and to the class of m. Only cells from which a newly won cell can be reached are looked at
again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.late import njit
from simgap.synthesis.abstraction.cells import (
    Abstraction,
    clip_boxes,
    count_holes,
    drop_boxes_with_holes,
    over_rows,
    table_size,
)
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.invariance import row_index
from simgap.synthesis.games.reach_rows import reach_by_rows
from simgap.synthesis.games.row_moves import RowSystem, with_common_sweeps
from simgap.synthesis.input_sets import packed_width, preferred

Backend = Literal["auto", "bit_rows", "table"]
MOST_KEPT = 1 << 28
"""Numbers of boxes that are made once and kept, 1 GiB of them: beyond it they are made again at every level."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Result of the least fixed point over nodes: number cell * classes + class of the previous input.

    Attributes:
        value: worst-case steps to the target, (nodes,) int32, 0 in the target and -1 where losing.
        mask: admissible inputs, (nodes, ceil(M / 8)) uint8 as in `input_sets`, none in the target; (nodes, 0) if not
            asked.
        chosen: one admissible input of each node, (nodes,) int16, -1 in the target and where losing; (0,) if not asked.
        steps: the largest value.
        backend: `bit_rows` or `table`.
    """

    value: NDArray[np.int32]
    mask: NDArray[np.uint8]
    chosen: NDArray[np.int16]
    steps: int
    backend: str

    @property
    def winning(self) -> Bools:
        """Winning nodes, the target included, (nodes,)."""
        return self.value >= 0


def reach_avoid(
    boxes: Abstraction | Sequence[Abstraction],
    target: Bools,
    free: Bools,
    threads: int = 1,
    backend: Backend = "auto",
    order: Ints | None = None,
    kind: Ints | None = None,
) -> Reach:
    """Nodes from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        boxes: abstraction of the plant, or one after a previous input of each class, on the same cells and inputs.
        target: cells to reach, (cells,); those that are not free do not count.
        free: cells that a run may visit, (cells,).
        threads: rows are shared among this many threads; the result does not depend on it.
        backend: `bit_rows` where some axis allows it and else `table`, unless one is asked for.
        order: all inputs from the one that is liked best, (M,), of which each node's first admissible one is recorded
            in the place of all: two bytes a node instead of a bit for each input. A controller whose rule has that
            order (`controller.least_effort`) applies the same inputs.
        kind: (M,) class of each input; all of one class when None.

    Raises:
        UserError: `bit_rows` asked for where every axis matters.
    """
    every = [boxes] if isinstance(boxes, Abstraction) else list(boxes)
    inputs = len(every[0].inputs)
    kind = np.zeros(inputs, np.int64) if kind is None else kind
    found = [] if backend == "table" else [RowSystem.of(a) for a in every]
    rows = [own for own in found if own is not None]
    by_rows = len(rows) == len(every)
    if not by_rows and backend == "bit_rows":
        raise UserError(
            "no axis allows bit rows: every offset depends on it, it is periodic, or the boxes differ too much",
            remedy="Use the table backend",
        )
    if not by_rows and any(a.swept is not None for a in every):
        raise UserError(
            "the path between samples is checked on bit rows only, and no axis allows them",
            remedy="Use a gap that does not depend on the position, or fewer cells",
        )
    goal = target & free
    if by_rows:
        value, sets, chosen = reach_by_rows(with_common_sweeps(rows), kind, goal, free, threads, order)
        mask, chosen = sets.reshape(value.size, sets.shape[2]), chosen.reshape(-1)
    else:
        value, mask = reach_by_table(every, kind, goal, free, threads)
        chosen = np.empty(0, np.int16) if order is None else preferred(mask, order)
        mask = mask if order is None else mask[:, :0]
    return Reach(value.reshape(-1), mask, chosen, int(value.max(initial=0)), "bit_rows" if by_rows else "table")


def reach_by_table(
    boxes: Sequence[Abstraction], kind: Ints, target: Bools, free: Bools, threads: int
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Levels and admissible inputs: sets of cells (cells,) -> value (nodes,), mask (nodes, bytes)."""
    grid, inputs, shape = boxes[0].grid, len(kind), boxes[0].shape
    n, row, rows = grid.box.size, grid.cells[-1], grid.size // grid.cells[-1]
    classes = len(boxes)
    value = np.tile(np.where(target, 0, -1).astype(np.int32), (classes, 1))
    mask = np.zeros((classes, grid.size, packed_width(inputs)), np.uint8)
    systems = [(a.post, a.meta, a.data, a.table, shape, n, inputs, row) for a in boxes]
    reach = np.empty((classes, rows, 2 * n), np.int32)
    every, size = table_meta(grid, inputs, (tuple(range(n)),) * n)
    for c, a in enumerate(boxes):
        keeps = a.post is not table_post() and 2 * size * classes <= MOST_KEPT
        kept = np.empty((n, grid.size * keeps, inputs, 2), np.int32)
        over_rows(partial(_reach, *systems[c], reach[c], kept), rows, threads)
        if keeps:
            systems[c] = (table_post(), every, a.data, kept.reshape(-1), *systems[c][4:])
    won, news = np.empty((classes, table_size(shape, n)), np.int32), np.empty(table_size(shape, n), np.int32)
    quiet = np.tile((~target).view(np.uint8), (classes, 1))
    level = 0
    while not quiet.all():
        level += 1
        for own_value, table in zip(value, won, strict=True):
            count_holes((own_value >= 0).view(np.uint8), shape, n, table)
        count_holes(quiet.min(axis=0), shape, n, news)
        quiet[:] = 1
        for c, own in enumerate(systems):
            state = kind, won, news, reach[c], free.view(np.uint8), quiet[c], value[c], mask[c]
            over_rows(partial(_level, *own, *state, level), rows, threads)
    return np.ascontiguousarray(value.T).reshape(-1), np.moveaxis(mask, 0, 1).reshape(value.size, -1)


@njit(cache=True, nogil=True)
def _reach(post, meta, data, tab, shape, n, inputs, row, reach, kept, first, last):  # type: ignore[no-untyped-def]
    """Box of offsets that the boxes of a row's cells span, relative to the cell: (rows, 2n).

    The offsets of every cell themselves are in `kept` (n, cells, M, 2), if there is room for cells.
    """
    k = np.zeros(4, np.int64)
    out = np.zeros(2 * n * inputs, np.int32)
    for r in range(first, last):
        row_index(r, shape, n, k)
        for j in range(n):
            reach[r, j], reach[r, n + j] = 2**30, -(2**30)
        for i in range(row):
            k[n - 1] = i
            post(k.ctypes, 1, 1, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
            for m in range(inputs):
                for j in range(n):
                    reach[r, j] = min(reach[r, j], out[2 * n * m + j] - k[j])
                    reach[r, n + j] = max(reach[r, n + j], out[2 * n * m + n + j] - k[j])
                    if kept.shape[1]:
                        kept[j, r * row + i, m, 0] = out[2 * n * m + j] - k[j]
                        kept[j, r * row + i, m, 1] = out[2 * n * m + n + j] - k[j]
    return 0


@njit(cache=True, nogil=True)
def _surroundings(shape, n, k, row, reach, boxes, ok):  # type: ignore[no-untyped-def]
    """The clipped box that each cell of a row can reach at all; `ok` is 1 for every one of them."""
    for i in range(row):
        k[n - 1] = i
        for j in range(n):
            lo, hi = k[j] + reach[j], k[j] + reach[n + j]
            if not shape[1, j]:
                lo, hi = min(max(lo, 0), shape[0, j] - 1), min(max(hi, 0), shape[0, j] - 1)
            boxes[2 * n * i + j], boxes[2 * n * i + n + j] = lo, hi
    clip_boxes(shape, n, boxes, np.int64(0), row, ok)


@njit(cache=True, nogil=True)
def _drop_outside(won, kind, shape, n, boxes, ok, own):  # type: ignore[no-untyped-def]
    """Set `ok[m]` = 0 where the box of input m is not in what the class of m has won; `own` (M,) is overwritten."""
    if won.shape[0] == 1:
        drop_boxes_with_holes(won[0], shape, n, boxes, np.int64(0), ok.size, ok)
        return
    for c in range(won.shape[0]):
        for m in range(ok.size):
            own[m] = ok[m] if kind[m] == c else 0
        drop_boxes_with_holes(won[c], shape, n, boxes, np.int64(0), ok.size, own)
        for m in range(ok.size):
            if kind[m] == c:
                ok[m] = own[m]


@njit(cache=True, nogil=True)
def _level(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, n, inputs, row, kind, won, news, reach, free, quiet, value, mask, level, first, last
):
    """Win the cells of the rows first..last that some input takes into what its class has `won`; returns how many."""
    k = np.zeros(4, np.int64)
    out, around = np.zeros(2 * n * inputs, np.int32), np.zeros(2 * n * row, np.int32)
    ok, own, far = np.zeros(inputs, np.uint8), np.zeros(inputs, np.uint8), np.zeros(row, np.uint8)
    number = 0
    for r in range(first, last):
        row_index(r, shape, n, k)
        _surroundings(shape, n, k, row, reach[r], around, far)
        drop_boxes_with_holes(news, shape, n, around, np.int64(0), row, far)  # left: no newly won cell in reach
        for i in range(row):
            cell = r * row + i
            if far[i] or value[cell] >= 0 or not free[cell]:
                continue
            k[n - 1] = i
            post(k.ctypes, 1, 1, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
            clip_boxes(shape, n, out, np.int64(0), inputs, ok)
            _drop_outside(won, kind, shape, n, out, ok, own)
            if not ok.any():
                continue
            value[cell] = level
            quiet[cell] = 0
            number += 1
            for m in range(inputs):
                mask[cell, m >> 3] |= np.uint8(ok[m] << (m & 7))
    return number
