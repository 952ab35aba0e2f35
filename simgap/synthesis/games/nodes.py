"""The game on nodes, by tables: which nodes have an input that takes whatever may follow into a set of nodes.

A node is a cell k of the state and what is remembered there: the class c of the input before, where the plant remembers
it (one class where it does not), and the input p that acts now, where inputs act a sample after they are chosen.

    at once:       (k, c)  --u-->  (k', class of u)       for every k' in the box of (k, u) in class c,
    late:       (k, p, c)  --u-->  (k', u, class of p)    for every k' in the box of (k, p) in class c.

Sets of nodes are (classes, cells, P), P = 1, or M where inputs are late. Write A(c, k) for the inputs p with (k, p, c)
in a set. A step from a late node stays in the set with exactly the inputs in

    AND of A(class of p, k') over k' in the box of (k, p) in class c.

`after` says for each class which one an input leads to. So whatever else is to be remembered and changes with the input
(or, once a set is read at what its cells mean, with the cell) is one more factor of the classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.late import njit
from simgap.synthesis.abstraction.cells import (
    Abstraction,
    clip_boxes,
    count_holes,
    drop_boxes_with_holes,
    over_rows,
)
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.invariance import admissible_inputs, row_index
from simgap.synthesis.input_sets import Bytes, packed_width, to_bytes, unpack, words_of

MOST_KEPT = 1 << 28
"""Numbers of boxes that are made once and kept, 1 GiB of them: beyond it they are made again at every step."""
UNTOUCHED, NONE, SOME = 0, 1, 2


class NodeStep:
    """The operator: inputs that take nodes into a set.

    Args:
        boxes: one abstraction for each class, on the same cells and inputs. kind: (M,) the class after each input.
        late: whether inputs act a sample after they are chosen.
        threads: rows are shared among this many threads; the result does not depend on it.
        often: whether it is worth finding first how far each row reaches, and keeping the boxes.
    """

    def __init__(self, boxes: Sequence[Abstraction], kind: Ints, late: bool, threads: int, often: bool = False) -> None:
        grid, n, shape, inputs = boxes[0].grid, boxes[0].grid.box.size, boxes[0].shape, len(kind)
        self._late, self._threads, self._rows = late, threads, grid.size // grid.cells[-1]
        self._after = np.tile(kind, (len(boxes), 1))
        self.shape = len(boxes), grid.size, inputs if late else 1
        self._frame = (shape, n, inputs, grid.cells[-1])
        self._posts: list[tuple[Any, ...]] = [(a.post, a.meta, a.data, a.table) for a in boxes]
        self._spans = np.empty((len(boxes), self._rows * often, 2 * n), np.int32)
        every, size = table_meta(grid, inputs, (tuple(range(n)),) * n)
        for c, a in enumerate(boxes if often else ()):
            keeps = a.post is not table_post() and 2 * size * len(boxes) <= MOST_KEPT
            kept = np.empty((n, grid.size * keeps, inputs, 2), np.int32)
            over_rows(partial(_span, *self._posts[c], *self._frame, self._spans[c], kept), self._rows, threads)
            if keeps:
                self._posts[c] = (table_post(), every, a.data, kept.reshape(-1))

    def no_inputs(self) -> NDArray[Any]:
        """Empty sets of inputs of nodes: (classes, cells, P, words), of 64 bits where inputs are late, else of 8."""
        inputs = self._after.shape[1]
        wide = np.uint64, -(-inputs // 64)
        dtype, words = wide if self._late else (np.uint8, packed_width(inputs))
        return np.zeros((*self.shape, words), dtype)

    def flat(self, sets: NDArray[Any]) -> NDArray[Any]:
        """What nodes have, (classes, cells, P, ...), in the order of a `Solution`, cell, P, class: (nodes, ...)."""
        rows = np.moveaxis(sets, 0, 2).reshape(-1, *sets.shape[3:])
        return to_bytes(rows, self._after.shape[1]) if rows.dtype == np.uint64 else rows

    def able(self, boxes: Sequence[Abstraction], free: Bools) -> Bools:
        """Nodes in free cells (cells,) from which the input that acts takes a clear path, where inputs are late."""
        out = np.broadcast_to(free[None, :, None], self.shape).copy()
        shape, n = self._frame[:2]
        for own, a in zip(out, boxes, strict=True):
            if a.swept is not None:
                table = count_holes(free, shape, n)
                clear, _ = admissible_inputs(a.paths(), table, np.ones(len(free), np.uint8), self._threads)
                own &= unpack(clear, len(a.inputs))
        return out

    def __call__(self, inside: Bools, news: Bools, todo: Bools, sets: NDArray[Any]) -> Bytes:
        """Look at the nodes `todo` from which one of the `news` can be reached; all are (classes, cells, P).

        Returns:
            (classes, cells, P): UNTOUCHED, NONE where no input leads into the set `inside` for sure, SOME where `sets`
            holds those that do.
        """
        shape, n = self._frame[:2]
        here, new = (np.any(s, axis=-1) if self._late else s[..., 0] for s in (inside, news))
        holes = np.stack([count_holes(own, shape, n) for own in here])
        quiet = np.stack([count_holes(~own, shape, n) for own in (*(new if self._late else ()), new.any(axis=0))])
        allowed = words_of(inside) if self._late else np.zeros((len(inside), 0, 0), np.uint8)
        found, look = np.zeros(todo.shape, np.uint8), todo.view(np.uint8)
        for c, post in enumerate(self._posts):
            own = self._after[c], holes, quiet, allowed, self._spans[c], look[c], sets[c], found[c]
            over_rows(partial(_keep, *post, *self._frame, *own), self._rows, self._threads)
        return found


def bytes_of_nodes(cells: int, inputs: int, classes: int = 1) -> int:
    """Memory that a game with late inputs takes: sets of inputs, levels and flags."""
    return classes * cells * inputs * (8 * (-(-inputs // 64)) + 8)


def least_fixed_point(
    step: NodeStep, goal: Bools, able: Bools, steps: int | None = None
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Levels of nodes, at most `steps`, and the inputs that go down a level, from the goal and what may be won beside.

    Both are (classes, cells, P); the levels are 0 in the goal and -1 where losing; the inputs as in `no_inputs`. Nodes
    of the goal that are `able` have the level of an input that leads back into what is won, if there is one.
    """
    value, sets = np.where(goal, 0, -1).astype(np.int32), step.no_inputs()
    won, news, todo, level = goal.copy(), goal, able.copy(), 0
    while news.any() and level != steps:
        level += 1
        found = step(won, news, todo, sets) == SOME
        value[found] = level
        news, todo = found & ~won, todo & ~found
        won |= found
    return value, sets


@njit(cache=True, nogil=True)
def _span(post, meta, data, tab, shape, n, inputs, row, spans, kept, first, last):  # type: ignore[no-untyped-def]
    """Box of offsets that the boxes of a row's cells span, relative to the cell: (rows, 2n).

    The offsets of every cell themselves are in `kept` (n, cells, M, 2), if there is room for cells.
    """
    k = np.zeros(4, np.int64)
    out = np.zeros(2 * n * inputs, np.int32)
    for r in range(first, last):
        row_index(r, shape, n, k)
        for j in range(n):
            spans[r, j], spans[r, n + j] = 2**30, -(2**30)
        for i in range(row):
            k[n - 1] = i
            post(k.ctypes, 1, 1, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, out.ctypes)
            for m in range(inputs):
                for j in range(n):
                    spans[r, j] = min(spans[r, j], out[2 * n * m + j] - k[j])
                    spans[r, n + j] = max(spans[r, n + j], out[2 * n * m + n + j] - k[j])
                    if kept.shape[1]:
                        kept[j, r * row + i, m, 0] = out[2 * n * m + j] - k[j]
                        kept[j, r * row + i, m, 1] = out[2 * n * m + n + j] - k[j]
    return 0


@njit(cache=True, nogil=True)
def _surroundings(shape, n, k, row, span, boxes, ok):  # type: ignore[no-untyped-def]
    """The clipped box that each cell of a row can reach at all; `ok` is 1 for every one of them."""
    for i in range(row):
        k[n - 1] = i
        for j in range(n):
            lo, hi = k[j] + span[j], k[j] + span[n + j]
            if not shape[1, j]:
                lo, hi = min(max(lo, 0), shape[0, j] - 1), min(max(hi, 0), shape[0, j] - 1)
            boxes[2 * n * i + j], boxes[2 * n * i + n + j] = lo, hi
    clip_boxes(shape, n, boxes, np.int64(0), row, ok)


@njit(cache=True, nogil=True)
def _drop_outside(tables, after, shape, n, boxes, ok, own):  # type: ignore[no-untyped-def]
    """Set `ok[m]` = 0 where the box of input m has a hole in the table of its class; `own` (M,) is overwritten."""
    if tables.shape[0] == 1:
        drop_boxes_with_holes(tables[0], shape, n, boxes, np.int64(0), ok.size, ok)
        return
    for c in range(tables.shape[0]):
        for m in range(ok.size):
            own[m] = ok[m] if after[m] == c else 0
        drop_boxes_with_holes(tables[c], shape, n, boxes, np.int64(0), ok.size, own)
        for m in range(ok.size):
            if after[m] == c:
                ok[m] = own[m]


@njit(cache=True, nogil=True)
def _keep(  # type: ignore[no-untyped-def]
    post, meta, data, tab, shape, n, inputs, row, after, holes, quiet, allowed, spans, todo, sets, found, first, last
):
    """Look at the nodes of the rows first..last in which there is something to do and news in reach."""
    late = allowed.size > 0
    k = np.zeros(4, np.int64)
    boxes, around = np.zeros(2 * n * inputs, np.int32), np.zeros(2 * n * row, np.int32)
    ok, still, own = np.zeros(inputs, np.uint8), np.zeros(inputs, np.uint8), np.zeros(inputs, np.uint8)
    far = np.zeros(row, np.uint8)
    for r in range(first, last):
        row_index(r, shape, n, k)
        if spans.size:
            _surroundings(shape, n, k, row, spans[r], around, far)
            drop_boxes_with_holes(quiet[-1], shape, n, around, np.int64(0), row, far)  # left: without news in reach
        for i in range(row):
            cell = r * row + i
            busy = False
            for p in range(0 if far[i] else todo.shape[1]):
                if todo[cell, p]:
                    busy = True
                    break
            if not busy:
                continue
            k[n - 1] = i
            post(k.ctypes, 1, 1, 0, inputs, meta.ctypes, data.ctypes, tab.ctypes, boxes.ctypes)
            clip_boxes(shape, n, boxes, np.int64(0), inputs, ok)
            if late:
                for m in range(inputs):
                    ok[m] = ok[m] and todo[cell, m]
                    still[m] = ok[m]
                _drop_outside(quiet[:-1], after, shape, n, boxes, still, own)
            _drop_outside(holes, after, shape, n, boxes, ok, own)
            if late:
                for m in range(inputs):
                    if todo[cell, m] and not still[m]:
                        some = ok[m] and _and_over_box(shape, n, boxes, 2 * n * m, allowed[after[m]], sets[cell, m])
                        found[cell, m] = SOME if some else NONE
            elif ok.any():
                found[cell, 0] = SOME
                for m in range(inputs):
                    sets[cell, 0, m >> 3] |= np.uint8(ok[m] << (m & 7))
    return 0


@njit(cache=True, nogil=True)
def _and_over_box(shape, n, boxes, at, allowed, out):  # type: ignore[no-untyped-def]
    """AND of `allowed` (cells, words) over the clipped box `boxes[at:]` into `out` (words,); whether any is left."""
    total = np.int64(1)
    for j in range(n):
        total *= boxes[at + n + j] - boxes[at + j] + 1
    for number in range(total):
        rest, flat, stride = number, np.int64(0), np.int64(1)
        for j in range(n - 1, -1, -1):
            extent = boxes[at + n + j] - boxes[at + j] + 1
            flat += (boxes[at + j] + rest % extent) % shape[0, j] * stride
            rest //= extent
            stride *= shape[0, j]
        left = False
        for w in range(out.size):
            out[w] = allowed[flat, w] & out[w] if number else allowed[flat, w]
            left |= out[w] != 0
        if not left:
            return False
    return True
