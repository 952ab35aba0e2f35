"""Maximal controlled invariant set on an abstraction, as the greatest fixed point of the controlled predecessor.

A sweep visits the cells whose remembered input may have lost its successor; a cell that can no longer use it looks for the
next input that works, and never looks back, because an input that failed once fails for every smaller set. The set is the
greatest fixed point and therefore the same in any order of visits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.holes import clip_box, count_holes, holes_in, layout, table_size
from simgap.synthesis.threads import over_rows

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Invariance:
    """What the fixed point found.

    Attributes:
        winning: cells from which the safe set can be kept for ever, (cells,) bool.
        mask: admissible inputs, (cells, ceil(M / 8)) uint8, bit m % 8 of byte m // 8 is input m.
        pairs: number of admissible (cell, input) pairs.
        sweeps: sweeps until nothing changed.
    """

    winning: NDArray[np.bool_]
    mask: Bytes
    pairs: int
    sweeps: int


def invariance(abstraction: Abstraction, safe: NDArray[np.bool_] | None = None, threads: int = 1) -> Invariance:
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
    remembered = np.full(grid.size, -1, np.int32)
    boxes = np.zeros((grid.size, 2 * n), np.int32)
    lead = grid.cells[:-1] or (1,)
    lead_shape = layout(lead, tuple(j for j in grid.periodic if j < n - 1))
    reach = np.zeros((rows, 2 * len(lead)), np.int64)
    unchanged = np.zeros(rows, np.uint8)
    table = np.empty(table_size(shape, n), np.int32)
    changed_table = np.empty(table_size(lead_shape, len(lead)), np.int32)
    arrays = (abstraction.meta, abstraction.data, abstraction.table)
    sweeps = 0
    while True:
        count_holes(inside, shape, n, table)
        count_holes(unchanged, lead_shape, len(lead), changed_table)
        unchanged = np.ones(rows, np.uint8)
        state = (inside, remembered, boxes, reach, unchanged)
        lost = over_rows(
            lambda first, last, s=state, start=sweeps == 0: _sweep(
                abstraction.post, *arrays, shape, lead_shape, n, inputs, row, table, changed_table, *s, start, first, last
            ),
            rows,
            threads,
        )
        sweeps += 1
        if lost == 0:
            break
    mask = np.zeros((grid.size, (inputs + 7) // 8), np.uint8)
    pairs = over_rows(
        lambda first, last: _admissible(
            abstraction.post, *arrays, shape, n, inputs, row, table, inside, remembered, mask, first, last
        ),
        rows,
        threads,
    )
    return Invariance(inside.view(np.bool_), mask, pairs, sweeps)


@nb.njit(cache=True, nogil=True, inline="always")
def _unravel(cell, shape, n, k):  # type: ignore[no-untyped-def]
    for j in range(n - 1, -1, -1):
        k[j] = cell % shape[0, j]
        cell //= shape[0, j]


@nb.njit(cache=True, nogil=True)
def _next_input(post, meta, data, tab, shape, n, inputs, table, k, first, out):  # type: ignore[no-untyped-def]
    """First input >= `first` whose box lies in the set (its clipped box is left in `out[:2n]`), or `inputs`."""
    m = first
    block = 1
    while m < inputs:
        last = min(m + block, inputs)
        post(k.ctypes, m, last, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
        for i in range(last - m):
            at = 2 * n * i
            if clip_box(out, at, shape, n) and holes_in(table, shape, n, out, at) == 0:
                for j in range(2 * n):
                    out[j] = out[at + j]
                return m + i
        m = last
        block = 8
    return inputs


@nb.njit(cache=True, nogil=True)
def _sweep(post, meta, data, tab, shape, lead_shape, n, inputs, row, table, changed, inside, remembered, boxes, reach,
           unchanged, start, first, last):  # type: ignore[no-untyped-def]  # fmt: skip
    """One sweep over the rows first..last; returns how many cells were lost."""
    k = np.zeros(4, np.int64)
    out = np.zeros(16 * n, np.int64)
    lead = max(n - 1, 1)
    lost = 0
    for r in range(first, last):
        if not start and (reach[r, 0] < 0 or holes_in(changed, lead_shape, lead, reach[r], 0) == 0):
            continue
        reach[r, :] = -1
        alive = False
        for cell in range(r * row, (r + 1) * row):
            if not inside[cell]:
                continue
            for j in range(2 * n):
                out[j] = boxes[cell, j]
            if remembered[cell] < 0 or holes_in(table, shape, n, out, 0) != 0:
                _unravel(cell, shape, n, k)
                m = _next_input(post, meta, data, tab, shape, n, inputs, table, k, remembered[cell] + 1, out)
                if m == inputs:
                    inside[cell] = 0
                    unchanged[r] = 0
                    lost += 1
                    continue
                remembered[cell] = m
                for j in range(2 * n):
                    boxes[cell, j] = out[j]
            for j in range(n - 1):
                reach[r, j] = min(reach[r, j], out[j]) if alive else out[j]
                reach[r, lead + j] = max(reach[r, lead + j], out[n + j]) if alive else out[n + j]
            if n == 1:
                reach[r, :] = 0
            alive = True
    return lost


@nb.njit(cache=True, nogil=True)
def _admissible(post, meta, data, tab, shape, n, inputs, row, table, inside, remembered, mask, first, last):  # type: ignore[no-untyped-def]
    """Write the bits of all admissible inputs of the rows first..last; returns how many."""
    k = np.zeros(4, np.int64)
    out = np.zeros(2 * n * inputs, np.int64)
    pairs = 0
    for cell in range(first * row, last * row):
        if not inside[cell]:
            continue
        _unravel(cell, shape, n, k)
        m0 = remembered[cell]
        post(k.ctypes, m0, inputs, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
        for m in range(m0, inputs):
            at = 2 * n * (m - m0)
            if clip_box(out, at, shape, n) and holes_in(table, shape, n, out, at) == 0:
                mask[cell, m >> 3] |= np.uint8(1 << (m & 7))
                pairs += 1
    return pairs
