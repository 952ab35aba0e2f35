"""Reach-while-avoid: the value function is the level at which a cell is won, counted in worst-case steps to the target.

Level 0 is the target. A free cell is won at level l when some input's box lies wholly in the cells of levels below l;
the inputs that do so at that moment are exactly those that go down a level, and they are the admissible ones. Only
cells from which a newly won cell can be reached are looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.late import njit
from simgap.synthesis.abstraction.cells import Abstraction, clip_boxes, count_holes, drop_boxes_with_holes, table_size
from simgap.synthesis.games.invariance import row_index
from simgap.synthesis.games.reach_rows import reach_by_rows
from simgap.synthesis.games.row_moves import RowSystem
from simgap.synthesis.games.threads import over_rows
from simgap.synthesis.input_sets import packed_width, preferred

Backend = Literal["auto", "bit_rows", "table"]


@dataclass(frozen=True, eq=False)
class Reach:
    """Result of the least fixed point.

    Attributes:
        value: worst-case steps to the target, (cells,) int32, 0 in the target and -1 where losing.
        mask: admissible inputs, (cells, ceil(M / 8)) uint8 as in `bits`, none in the target; (cells, 0) with an order.
        chosen: one admissible input of each cell, (cells,) int16, -1 in the target and where losing; (0,) if not asked.
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
        """Winning cells, the target included, (cells,)."""
        return self.value >= 0


def reach_avoid(
    abstraction: Abstraction,
    target: Bools,
    free: Bools,
    threads: int = 1,
    backend: Backend = "auto",
    order: Ints | None = None,
) -> Reach:
    """Cells from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        abstraction: cells, inputs and post.
        target: cells to reach, (cells,); those that are not free do not count.
        free: cells that a run may visit, (cells,).
        threads: rows are shared among this many threads; the result does not depend on it.
        backend: `bit_rows` where some axis allows it and else `table`, unless one is asked for.
        order: all inputs from the one that is liked best, (M,), of which each cell's first admissible one is recorded
            in the place of all: two bytes a cell instead of a bit for each input. A controller whose rule has that
            order (`controller.least_effort`) applies the same inputs.

    Raises:
        UserError: `bit_rows` asked for where every axis matters.
    """
    rows = None if backend == "table" else RowSystem.of(abstraction)
    if rows is None and backend == "bit_rows":
        raise UserError(
            "no axis allows bit rows: every offset depends on it, it is periodic, or the boxes differ too much",
            remedy="Use the table backend",
        )
    if rows is None and abstraction.swept is not None:
        raise UserError(
            "the path between samples is checked on bit rows only, and no axis allows them",
            remedy="Use a gap that does not depend on the position, or fewer cells",
        )
    if rows is not None:
        kind = np.zeros(len(abstraction.inputs), np.int64)
        levels, sets, one = reach_by_rows([rows], kind, target & free, free, threads, order)
        value, mask, chosen = levels[:, 0], sets[:, 0], one[:, :1].reshape(-1)
    else:
        solve = (target & free).astype(np.uint8), free.astype(np.uint8)
        value, mask = reach_by_table(abstraction, *solve, threads)
        chosen = np.empty(0, np.int16) if order is None else preferred(mask, order)
        mask = mask if order is None else mask[:, :0]
    return Reach(value, mask, chosen, int(value.max(initial=0)), "table" if rows is None else "bit_rows")


def reach_by_table(
    abstraction: Abstraction, target: NDArray[np.uint8], free: NDArray[np.uint8], threads: int
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Levels and admissible inputs: flags (cells,) -> value (cells,), mask (cells, bytes)."""
    grid, n, shape = abstraction.grid, abstraction.grid.box.size, abstraction.shape
    row, rows = grid.cells[-1], grid.size // grid.cells[-1]
    model = (abstraction.post, abstraction.meta, abstraction.data, abstraction.table)
    value = np.where(target, 0, -1).astype(np.int32)
    mask = np.zeros((grid.size, packed_width(len(abstraction.inputs))), np.uint8)
    inputs = len(abstraction.inputs)
    reach = np.empty((rows, 2 * n), np.int32)
    over_rows(partial(_reach, *model, shape, n, inputs, row, reach), rows, threads)
    table, news = (np.empty(table_size(shape, n), np.int32) for _ in range(2))
    quiet = 1 - target
    level = 0
    while not quiet.all():
        level += 1
        count_holes((value >= 0).view(np.uint8), shape, n, table)
        count_holes(quiet, shape, n, news)
        quiet[:] = 1
        state = (table, news, reach, free, quiet, value, mask)
        over_rows(partial(_level, *model, shape, n, inputs, row, *state, level), rows, threads)
    return value, mask


@njit(cache=True, nogil=True)
def _reach(post, meta, data, tab, shape, n, inputs, row, reach, first, last):  # type: ignore[no-untyped-def]
    """Box of offsets that the boxes of a row's cells span, relative to the cell: (rows, 2n)."""
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
def _level(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, n, inputs, row, table, news, reach, free, quiet, value, mask, level, first, last
):
    """Win the cells of the rows first..last that some input takes into the table's set; returns how many."""
    k = np.zeros(4, np.int64)
    out, around = np.zeros(2 * n * inputs, np.int32), np.zeros(2 * n * row, np.int32)
    ok, far = np.zeros(inputs, np.uint8), np.zeros(row, np.uint8)
    won = 0
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
            drop_boxes_with_holes(table, shape, n, out, np.int64(0), inputs, ok)
            if not ok.any():
                continue
            value[cell] = level
            quiet[cell] = 0
            won += 1
            for m in range(inputs):
                mask[cell, m >> 3] |= np.uint8(ok[m] << (m & 7))
    return won
