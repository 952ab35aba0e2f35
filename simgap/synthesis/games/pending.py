"""The game over nodes (cell, memory) in which the input that is chosen acts one sample later.

A node is a cell k of the measured state, the input p that acts now, and the class c of the input before p where the
plant remembers it (one class where it does not). The controller chooses the next input u before it knows more:

    (k, p, c)  --u-->  (k', u, class of p)   for every k' in the box of (k, p) in class c.

Write A(c, k) for the inputs p with (k, p, c) in a set of nodes. One step stays in the set with exactly the inputs in

    AND of A(class of p, k') over k' in the box of (k, p) in class c.

To reach: level 0 are the nodes of the target; any other node is won at level l when its cell is free, the path of p
from it is clear, and that AND over the nodes of levels below l is not empty. Its admissible inputs are that AND at its
own level. To hold: the largest set of nodes in the safe cells for which none of these ANDs is empty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.late import njit
from simgap.specifications.solution import Solution
from simgap.synthesis.abstraction.cells import (
    Abstraction,
    clip_boxes,
    count_holes,
    drop_boxes_with_holes,
    over_rows,
    table_size,
)
from simgap.synthesis.games.game import CellGame, certified
from simgap.synthesis.games.invariance import admissible_inputs, row_index
from simgap.synthesis.input_sets import LARGEST_TABLES, Bytes, Words, to_bytes, unpack, words_of

UNTOUCHED, NONE, SOME = 0, 1, 2


def common_inputs(
    abstraction: Abstraction,
    kind: Ints,
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


def clear_paths(paths: Abstraction, free: Bools, threads: int) -> Bools:
    """True where the box of each input lies in the free cells, from every cell: (cells,) -> (cells, M)."""
    shape, n = paths.shape, paths.grid.box.size
    table = np.empty(table_size(shape, n), np.int32)
    count_holes(free.view(np.uint8), shape, n, table)
    mask, _ = admissible_inputs(paths, table, np.ones(paths.grid.size, np.uint8), threads)
    return unpack(mask, len(paths.inputs))


def bytes_of_nodes(cells: int, inputs: int, classes: int = 1) -> int:
    """Memory that a game takes: sets of inputs, levels and flags."""
    return classes * cells * inputs * (8 * (-(-inputs // 64)) + 8)


@dataclass(frozen=True, eq=False)
class LateGame(CellGame):
    """The game on nodes: a cell of the measured state, the input that acts now, and the class of the one before.

    Sets of nodes are (classes, cells, M) here; a `Solution` counts them in the order cell, input, class.

    Attributes:
        first: number of the input that acts in the first sample, before any measurement has arrived.
    """

    first: int = 0

    def __post_init__(self) -> None:
        inputs = len(self.boxes[0].inputs)
        needed = bytes_of_nodes(self.grid.size, inputs, len(self.boxes))
        if needed > LARGEST_TABLES:
            raise UserError(
                f"{self.grid.size} cells with {inputs} pending inputs are too many for a controller with latency: "
                f"{needed / 1e9:.1f} GB of nodes, at most {LARGEST_TABLES / 1e9:.1f} GB",
                key="synthesis.cells",
                remedy="Use fewer cells or inputs",
            )

    @property
    def _shape(self) -> tuple[int, int, int]:
        return len(self.boxes), self.grid.size, len(self.boxes[0].inputs)

    def invariant(self, safe: Bools) -> Solution:
        """The largest set of nodes of the safe cells (cells,) bool that can be held."""
        if any(a.swept is not None for a in self.boxes):
            raise BrokenPromise("swept boxes are not checked where a set is held", "Let the clearance cover them.")
        inside = self._able(safe)
        news, rounds = np.ones(self._shape[:2], np.bool_), 0
        sets = np.zeros((*self._shape, -(-self._shape[2] // 64)), np.uint64)
        while news.any():
            rounds += 1
            lost = self._state(words_of(inside), news, inside, sets) == NONE
            inside &= ~lost
            news = lost.any(axis=-1)
        return self._solution(inside, inside, sets, safe, rounds)

    def reach(self, target: Bools, free: Bools) -> Solution:
        """The least fixed point, levels and all inputs that go down a level.

        `target` is a set of cells (cells,) or of nodes (cells * memory,), `free` of cells, bool.
        """
        classes, cells, inputs = self._shape
        rows = cells, inputs, classes
        goal = np.broadcast_to(target.reshape(cells, -1, 1 if target.size == cells else classes), rows)
        able = self._able(free)
        value = np.where(np.moveaxis(goal, 2, 0) & free[None, :, None], 0, -1).astype(np.int32)
        allowed = words_of(value == 0)
        news: Bools = np.any(allowed, axis=-1)
        sets = np.zeros((*self._shape, allowed.shape[-1]), np.uint64)
        level = 0
        while news.any():
            level += 1
            new = self._state(allowed, news, able & (value < 0), sets) == SOME
            value[new] = level
            added = words_of(new)
            allowed |= added
            news = np.any(added, axis=-1)
        levels = np.moveaxis(value, 0, 2).reshape(-1)
        solution = self._solution(value >= 0, value > 0, sets, free, int(value.max(initial=0)))
        return replace(solution, value=levels, target=levels == 0)

    def _able(self, free: Bools) -> Bools:
        """Nodes in free cells whose pending input takes a clear path from there: (cells,) -> (classes, cells, M)."""
        out = np.broadcast_to(free[None, :, None], self._shape).copy()
        for own, a in zip(out, self.boxes, strict=True):
            if a.swept is not None:
                own &= clear_paths(a.paths(), free, self.threads)
        return out

    def _state(self, allowed: Words, news: Bools, todo: Bools, sets: Words) -> NDArray[np.uint8]:
        kind = np.zeros(self._shape[2], np.int64) if self.kind is None else self.kind
        flags, look = news.view(np.uint8), todo.view(np.uint8)
        every = zip(self.boxes, look, sets, strict=True)
        return np.stack([common_inputs(a, kind, allowed, flags, own, s, self.threads) for a, own, s in every])

    def _solution(self, inside: Bools, serving: Bools, sets: Words, free: Bools, rounds: int) -> Solution:
        """From the nodes of the set, those of them with inputs, and these: (classes, cells, M, words)."""
        classes, cells, inputs = self._shape
        mask = to_bytes(np.moveaxis(sets, 0, 2).reshape(cells * inputs * classes, -1), inputs)
        mask[~np.moveaxis(serving, 0, 2).reshape(-1)] = 0
        return Solution(
            grid=self.grid,
            winning=certified(inside[self.rest, :, self.first], self.grid, self.error),
            mask=mask,
            free=free,
            memory=inputs * classes,
            first=self.first * classes + self.rest,
            late=True,
            kind=self.kind if classes > 1 else None,
            statistics={"rounds": rounds, "nodes": int(inside.sum())},
        )
