"""Sets of inputs over boxes: for each node (cell, pending input) the next inputs that are right wherever it leads.

A node's pending input acts now and takes its cell into a box; the input chosen meanwhile must suit every cell of that
box. Sets of inputs are bits of 64-bit words, so that one AND over the box answers for all inputs at once.
"""

from __future__ import annotations

from functools import partial

import numba as nb
import numpy as np
from numpy.typing import NDArray

from simgap.geometry import Grid
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.holes import clip_boxes, count_holes, drop_boxes_with_holes, table_size
from simgap.synthesis.invariance import row_index
from simgap.synthesis.swept import SweptCells
from simgap.synthesis.threads import over_rows

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]
UNTOUCHED, NONE, SOME = 0, 1, 2


def words_of(flags: NDArray[np.bool_]) -> Words:
    """Flags of inputs as bits: (..., M) -> (..., ceil(M / 64)), input m is bit m % 64 of word m // 64."""
    wide = np.zeros((*flags.shape[:-1], 64 * (-(-flags.shape[-1] // 64))), np.bool_)
    wide[..., : flags.shape[-1]] = flags
    return np.packbits(wide, axis=-1, bitorder="little").view("<u8").astype(np.uint64)


def bytes_of(words: Words, inputs: int) -> Bytes:
    """Bits of inputs as packed bytes: (n, words) -> (n, ceil(M / 8))."""
    flat = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8).reshape(len(words), -1)
    return np.ascontiguousarray(flat[:, : (inputs + 7) // 8])


def common_inputs(
    abstraction: Abstraction,
    kind: NDArray[np.int64],
    allowed: Words,
    news: Bytes,
    todo: Bytes,
    sets: Words,
    threads: int,
) -> Bytes:
    """AND of `allowed` over the boxes of the nodes that are to be looked at and whose box holds news.

    Args:
        abstraction: boxes of (cell, input that acts).
        kind: (M,) the class that a node has after input m acted; `allowed` and `news` have one set a class.
        allowed: (classes, cells, words) inputs that may be pending in each cell.
        news: (classes, cells) where it has changed since the last call.
        todo: (cells, M) nodes to look at.
        sets: (cells, M, words), written for the nodes that are not untouched.
        threads: rows are shared among this many threads.

    Returns:
        (cells, M): UNTOUCHED, NONE where no input is common to the box or it leaves the grid, SOME elsewhere.
    """
    grid, n, shape = abstraction.grid, abstraction.grid.box.size, abstraction.shape
    row, inputs, classes = grid.cells[-1], len(abstraction.inputs), len(allowed)
    holes, quiet = (np.empty((classes, table_size(shape, n)), np.int32) for _ in range(2))
    for c in range(classes):
        count_holes(allowed[c].any(axis=1).view(np.uint8), shape, n, holes[c])
        count_holes(1 - news[c], shape, n, quiet[c])
    state = np.zeros((grid.size, inputs), np.uint8)
    model = (abstraction.post, abstraction.meta, abstraction.data, abstraction.table)
    work = partial(_common, *model, shape, n, inputs, row, kind, allowed, holes, quiet, todo, sets, state)
    over_rows(work, grid.size // row, threads)
    return state


@nb.njit(cache=True, nogil=True)
def _common(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, n, inputs, row, kind, allowed, holes, quiet, todo, sets, state, first, last
):
    k = np.zeros(4, np.int64)
    boxes = np.zeros(2 * n * inputs, np.int32)
    fits, inside, still = np.zeros(inputs, np.uint8), np.zeros(inputs, np.uint8), np.zeros(inputs, np.uint8)
    for r in range(first, last):
        row_index(r, shape, n, k)
        for i in range(row):
            cell = r * row + i
            if not todo[cell].any():
                continue
            k[n - 1] = i
            post(k.ctypes, 1, 1, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, boxes.ctypes)
            clip_boxes(shape, n, boxes, np.int64(0), inputs, fits)
            for c in range(allowed.shape[0]):
                for m in range(inputs):
                    own = kind[m] == c and todo[cell, m] != 0
                    inside[m], still[m] = fits[m] and own, fits[m] and own
                    if own and not fits[m]:
                        state[cell, m] = NONE
                drop_boxes_with_holes(quiet[c], shape, n, boxes, np.int64(0), inputs, still)
                drop_boxes_with_holes(holes[c], shape, n, boxes, np.int64(0), inputs, inside)
                for m in range(inputs):
                    if kind[m] != c or not todo[cell, m] or not fits[m] or still[m]:
                        continue
                    state[cell, m] = NONE
                    if inside[m] and _and_over_box(shape, n, boxes, 2 * n * m, allowed[c], sets[cell, m]):
                        state[cell, m] = SOME
    return 0


@nb.njit(cache=True, nogil=True)
def _and_over_box(shape, n, boxes, at, allowed, out):  # type: ignore[no-untyped-def]
    """AND of `allowed` (cells, words) over the clipped box `boxes[at:]` into `out` (words,); whether any is left."""
    total = np.int64(1)
    for j in range(n):
        total *= boxes[at + n + j] - boxes[at + j] + 1
    for w in range(out.size):
        out[w] = ~np.uint64(0)
    for number in range(total):
        rest, flat, stride = number, np.int64(0), np.int64(1)
        for j in range(n - 1, -1, -1):
            extent = boxes[at + n + j] - boxes[at + j] + 1
            flat += (boxes[at + j] + rest % extent) % shape[0, j] * stride
            rest //= extent
            stride *= shape[0, j]
        left = np.uint64(0)
        for w in range(out.size):
            out[w] &= allowed[flat, w]
            left |= out[w]
        if left == 0:
            return False
    return True


def clear_paths(grid: Grid, shape: NDArray[np.int64], swept: SweptCells, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the swept box of each input lies in the free cells, from every cell: (cells,) -> (cells, M)."""
    n, inputs = grid.box.size, swept.lower.shape[1]
    table = np.empty(table_size(shape, n), np.int32)
    count_holes(free.view(np.uint8), shape, n, table)
    out = np.zeros((grid.size, inputs), np.uint8)
    size = np.array(grid.cells, np.int32)
    lower, upper = np.maximum(swept.lower, -2 * size), np.minimum(swept.upper, 2 * size)
    _clear(shape, n, swept.axis, lower, upper, table, out)
    return out.view(np.bool_)


@nb.njit(cache=True, nogil=True)
def _clear(shape, n, axis, lower, upper, table, out):  # type: ignore[no-untyped-def]
    k, inputs = np.zeros(4, np.int64), out.shape[1]
    boxes = np.zeros(2 * n * inputs, np.int32)
    row = shape[0, n - 1]
    for cell in range(out.shape[0]):
        row_index(cell // row, shape, n, k)
        k[n - 1] = cell % row
        for m in range(inputs):
            for j in range(n):
                boxes[2 * n * m + j] = k[j] + lower[k[axis], m, j]
                boxes[2 * n * m + n + j] = k[j] + upper[k[axis], m, j]
        clip_boxes(shape, n, boxes, np.int64(0), inputs, out[cell])
        drop_boxes_with_holes(table, shape, n, boxes, np.int64(0), inputs, out[cell])
