"""Maximal controlled invariant set on an abstraction, as the greatest fixed point of the controlled predecessor.

A pass visits the cells whose remembered input may have lost its successor; a cell that can no longer use it looks for
the next input that works, and never looks back, because an input that failed once fails for every smaller set. The set
is the greatest fixed point and therefore the same in any order of visits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from simgap.arrays import Bools
from simgap.late import njit
from simgap.synthesis.abstraction.cells import (
    Abstraction,
    Counts,
    clip_boxes,
    count_holes,
    drop_boxes_with_holes,
    layout,
    over_rows,
)
from simgap.synthesis.input_sets import Bytes, packed_width


@dataclass(frozen=True, eq=False)
class InvariantSet:
    """Result of the greatest fixed point.

    Attributes:
        winning: cells from which the safe set can be kept for ever, (cells,) bool.
        mask: admissible inputs, (cells, ceil(M / 8)) uint8, bit m % 8 of byte m // 8 is input m.
        pairs: number of admissible (cell, input) pairs.
        passes: passes until nothing changed.
    """

    winning: Bools
    mask: Bytes
    pairs: int
    passes: int


def invariance(abstraction: Abstraction, safe: Bools | None = None, threads: int = 1) -> InvariantSet:
    """Largest set of safe cells in which some input keeps every successor, with all such inputs.

    Args:
        abstraction: cells, inputs and post.
        safe: cells to stay in, (cells,); all of them when None.
        threads: rows are shared among this many threads; the result does not depend on it.
    """
    grid, n, shape = abstraction.grid, abstraction.grid.box.size, abstraction.shape
    inputs = len(abstraction.inputs)
    inside = np.ones(grid.size, np.uint8) if safe is None else safe.astype(np.uint8).copy()
    row = grid.cells[-1]
    rows = grid.size // row
    remembered = np.zeros(grid.size, np.int32)
    boxes = np.zeros(grid.size * 2 * n, np.int32)
    lead = grid.cells[:-1] or (1,)
    lead_shape = layout(lead, tuple(j for j in grid.periodic if j < n - 1))
    reach = np.zeros(rows * 2 * len(lead), np.int32)
    unchanged = np.zeros(rows, np.uint8)
    arrays = (abstraction.meta, abstraction.data, abstraction.table)
    over_rows(partial(_start, abstraction.post, *arrays, shape, n, row, boxes), rows, threads)
    state = (inside, remembered, boxes, reach, unchanged)
    passes, lost = 0, 1
    while lost:
        table, changed = count_holes(inside, shape, n), count_holes(unchanged, lead_shape, len(lead))
        frame, start = (shape, lead_shape, n, inputs, row, table, changed), passes == 0
        unchanged[:] = 1
        lost = over_rows(partial(_pass, abstraction.post, *arrays, *frame, *state, start), rows, threads)
        passes += 1
    mask, pairs = admissible_inputs(abstraction, table, inside, threads)
    return InvariantSet(inside.view(np.bool_), mask, pairs, passes)


def admissible_inputs(abstraction: Abstraction, table: Counts, inside: Bytes, threads: int) -> tuple[Bytes, int]:
    """Inputs whose boxes hold no hole of the table, (cells, bytes), where `inside` (cells,) is not 0; their number."""
    grid, n, inputs = abstraction.grid, abstraction.grid.box.size, len(abstraction.inputs)
    row, mask = grid.cells[-1], np.zeros((grid.size, packed_width(inputs)), np.uint8)
    boxes = (abstraction.post, abstraction.meta, abstraction.data, abstraction.table, abstraction.shape, n, inputs)
    work = partial(_admissible, *boxes, row, abstraction.group, table, inside, mask)
    return mask, over_rows(work, grid.size // row, threads)


@njit(cache=True, nogil=True)
def row_index(r, shape, n, k):  # type: ignore[no-untyped-def]
    """Cell indices of the first cell of row `r` (cells that differ along the last axis only)."""
    k[n - 1] = 0
    for j in range(n - 2, -1, -1):
        k[j] = r % shape[0, j]
        r //= shape[0, j]


@njit(cache=True, nogil=True)
def _next_input(post, meta, data, tab, shape, n, inputs, table, k, first, out, ok):  # type: ignore[no-untyped-def]
    """First input >= `first` whose box lies in the set (its clipped box is left in `out[:2n]`), or `inputs`."""
    m = first
    while m < inputs:
        last = min(m + 8, inputs)
        post(k.ctypes, 1, 1, m, last, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
        clip_boxes(shape, n, out, np.int64(0), last - m, ok)
        drop_boxes_with_holes(table, shape, n, out, np.int64(0), last - m, ok)
        for i in range(last - m):
            if ok[i]:
                for j in range(2 * n):
                    out[j] = out[2 * n * i + j]
                return m + i
        m = last
    return inputs


@njit(cache=True, nogil=True)
def _start(post, meta, data, tab, shape, n, row, boxes, first, last):  # type: ignore[no-untyped-def]
    """Remember input 0 for every cell of the rows first..last; boxes that leave the grid become -1, a hole for good."""
    k = np.zeros(4, np.int64)
    out = np.zeros(2 * n * row, np.int32)
    ok = np.ones(row, np.uint8)
    for r in range(first, last):
        row_index(r, shape, n, k)
        post(k.ctypes, row, 1, 0, 1, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
        clip_boxes(shape, n, out, np.int64(0), row, ok)
        for i in range(row):
            for j in range(2 * n):
                boxes[2 * n * (r * row + i) + j] = out[2 * n * i + j] if ok[i] else -1
    return 0


@njit(cache=True, nogil=True)
def _idle(changed, lead_shape, lead, reach, r, dirty):  # type: ignore[no-untyped-def]
    """True if no cell that row `r` relies on has been lost in the last pass."""
    dirty[0] = 1
    if reach[2 * lead * r] <= reach[2 * lead * r + lead]:  # else the row is empty and relies on nothing
        drop_boxes_with_holes(changed, lead_shape, lead, reach, r, np.int64(1), dirty)
    return dirty[0] == 1


@njit(cache=True, nogil=True)
def _pass(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, lead_shape, n, inputs, row, table, changed,
    inside, remembered, boxes, reach, unchanged, start, first, last,
):  # fmt: skip
    """One pass over the rows first..last; returns how many cells were lost."""
    k = np.zeros(4, np.int64)
    out = np.zeros(16 * n, np.int32)
    ok, fit, dirty = np.ones(row, np.uint8), np.ones(8, np.uint8), np.ones(1, np.uint8)
    lead = max(n - 1, 1)
    lost = 0
    for r in range(first, last):
        if not start and n > 1 and _idle(changed, lead_shape, lead, reach, r, dirty):
            continue
        for i in range(row):
            ok[i] = inside[r * row + i] and boxes[2 * n * (r * row + i)] >= 0
        drop_boxes_with_holes(table, shape, n, boxes, r * row, row, ok)
        row_index(r, shape, n, k)
        lost_before = lost
        for i in range(row):
            cell = r * row + i
            if inside[cell] and not ok[i]:
                k[n - 1] = i
                m = _next_input(post, meta, data, tab, shape, n, inputs, table, k, remembered[cell] + 1, out, fit)
                remembered[cell] = m
                if m == inputs:
                    inside[cell] = 0
                    lost += 1
                for j in range(2 * n):
                    boxes[2 * n * cell + j] = out[j]
        if lost > lost_before:
            unchanged[r] = 0
        _rely(inside, boxes, reach, r, row, n, lead)
    return lost


@njit(cache=True, nogil=True)
def _rely(inside, boxes, reach, r, row, n, lead):  # type: ignore[no-untyped-def]
    """The box of leading indices that the remembered boxes of row `r` cover (empty if no cell is left)."""
    for j in range(n - 1):
        least, most = 2**30, -1
        for i in range(r * row, (r + 1) * row):
            if inside[i]:
                least = min(least, boxes[2 * n * i + j])
                most = max(most, boxes[2 * n * i + n + j])
        reach[2 * lead * r + j] = least
        reach[2 * lead * r + lead + j] = most


@njit(cache=True, nogil=True)
def _admissible(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, n, inputs, row, group, table, inside, mask, first, last
):
    """Write the bits of all admissible inputs of the rows first..last; returns how many.

    What a box for a group of cells cannot decide is decided by the cell's own.
    """
    k = np.zeros(4, np.int64)
    batch = min(row, max(8, 4096 // inputs))
    out, own = np.zeros(2 * n * inputs * batch, np.int32), np.zeros(2 * n, np.int32)
    ok, fit = np.zeros(inputs * batch, np.uint8), np.zeros(1, np.uint8)
    pairs = 0
    for r in range(first, last):
        row_index(r, shape, n, k)
        for left in range(0, row, batch):
            count = min(batch, row - left)
            alive = 0
            for i in range(count):
                alive += inside[r * row + left + i]
            if alive == 0:
                continue
            k[n - 1] = left
            post(k.ctypes, count, group, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
            clip_boxes(shape, n, out, np.int64(0), count * inputs, ok)
            drop_boxes_with_holes(table, shape, n, out, np.int64(0), count * inputs, ok)
            for i in range(count):
                cell = r * row + left + i
                if not inside[cell]:
                    continue
                for m in range(inputs):
                    good = ok[i * inputs + m]
                    if group > 1 and not good:
                        k[n - 1] = left + i
                        good = _next_input(post, meta, data, tab, shape, n, m + 1, table, k, m, own, fit) == m
                    mask[cell, m >> 3] |= np.uint8(good << (m & 7))
                    pairs += good
    return pairs
