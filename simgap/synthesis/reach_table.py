"""Reach-while-avoid with summed-area look-ups, for boxes that differ from cell to cell (see `holes`)."""

from __future__ import annotations

from functools import partial

import numba as nb
import numpy as np
from numpy.typing import NDArray

from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.bits import packed_width
from simgap.synthesis.holes import clip_boxes, count_holes, drop_boxes_with_holes, table_size
from simgap.synthesis.invariance import row_index
from simgap.synthesis.threads import over_rows


def reach_by_table(
    abstraction: Abstraction, target: NDArray[np.uint8], free: NDArray[np.uint8], threads: int, masks: bool
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Levels and admissible inputs: flags (cells,) -> value (cells,), mask (cells, bytes), (cells, 0) without masks."""
    grid, n, shape = abstraction.grid, abstraction.grid.box.size, abstraction.shape
    row, rows = grid.cells[-1], grid.size // grid.cells[-1]
    model = (abstraction.post, abstraction.meta, abstraction.data, abstraction.table)
    value = np.where(target, 0, -1).astype(np.int32)
    mask = np.zeros((grid.size, packed_width(len(abstraction.inputs)) if masks else 0), np.uint8)
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


@nb.njit(cache=True, nogil=True)
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


@nb.njit(cache=True, nogil=True)
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


@nb.njit(cache=True, nogil=True)
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
            if mask.shape[1] > 0:
                for m in range(inputs):
                    mask[cell, m >> 3] |= np.uint8(ok[m] << (m & 7))
    return won
