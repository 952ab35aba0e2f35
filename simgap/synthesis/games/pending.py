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

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.late import njit
from simgap.synthesis.abstraction.cells import Abstraction, clip_boxes, count_holes, drop_boxes_with_holes, table_size
from simgap.synthesis.abstraction.swept import SweptCells
from simgap.synthesis.games.invariance import row_index
from simgap.synthesis.games.threads import over_rows
from simgap.synthesis.input_sets import Bytes, Words, to_bytes, words_of

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


def clear_paths(grid: Grid, shape: Ints, swept: SweptCells, free: Bools) -> Bools:
    """True where the swept box of each input lies in the free cells, from every cell: (cells,) -> (cells, M)."""
    n, inputs = grid.box.size, swept.lower.shape[1]
    table = np.empty(table_size(shape, n), np.int32)
    count_holes(free.view(np.uint8), shape, n, table)
    out = np.zeros((grid.size, inputs), np.uint8)
    size = np.array(grid.cells, np.int32)
    lower, upper = np.maximum(swept.lower, -2 * size), np.minimum(swept.upper, 2 * size)
    _clear(shape, n, swept.axis, lower, upper, table, out)
    return out.view(np.bool_)


@njit(cache=True, nogil=True)
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


LARGEST_NODES = 1_500_000_000
"""Most bytes of the nodes' sets of inputs, levels and flags together."""


def bytes_of_nodes(cells: int, inputs: int, classes: int = 1) -> int:
    """Memory that a game takes: sets of inputs, levels and flags."""
    return classes * cells * inputs * (8 * (-(-inputs // 64)) + 8)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Sets of nodes and their inputs.

    Attributes:
        inside: (classes, cells, M) bool, nodes of the set.
        sets: (classes, cells, M, words) admissible inputs of each node, meaningless outside.
        value: (classes, cells, M) int32 levels, -1 outside; None where nothing is to be reached.
        rounds: levels, or passes until nothing changed.
    """

    inside: Bools
    sets: Words
    value: NDArray[np.int32] | None
    rounds: int

    def mask(self) -> Bytes:
        """Admissible inputs as packed bytes, row (cell * M + pending) * classes + class: none in the target."""
        classes, cells, inputs = self.inside.shape
        rows = np.moveaxis(self.sets, 0, 2).reshape(cells * inputs * classes, -1)
        mask = to_bytes(rows, inputs)
        serving = self.inside if self.value is None else self.value > 0
        mask[~np.moveaxis(serving, 0, 2).reshape(-1)] = 0
        return mask


@dataclass(frozen=True, eq=False)
class PendingGame:
    """Boxes of a plant whose inputs act one sample late.

    Attributes:
        boxes: abstractions on the same cells and inputs, one for each class of the input before the pending one.
        kind: (M,) class of each input.
        threads: rows are shared among this many threads; results do not depend on it.
    """

    boxes: tuple[Abstraction, ...]
    kind: Ints
    threads: int = 1

    @staticmethod
    def of(abstraction: Abstraction, threads: int = 1) -> PendingGame:
        """A plant that remembers no input."""
        return PendingGame((abstraction,), np.zeros(len(abstraction.inputs), np.int64), threads)

    def __post_init__(self) -> None:
        needed = bytes_of_nodes(self.grid.size, self.inputs, len(self.boxes))
        if needed > LARGEST_NODES:
            raise UserError(
                f"{self.grid.size} cells with {self.inputs} pending inputs are too many for a controller with latency: "
                f"{needed / 1e9:.1f} GB of nodes, at most {LARGEST_NODES / 1e9:.1f} GB",
                key="synthesis.cells",
                remedy="Use fewer cells or inputs",
            )

    @property
    def grid(self) -> Grid:
        """The cells."""
        return self.boxes[0].grid

    @property
    def inputs(self) -> int:
        """M."""
        return len(self.boxes[0].inputs)

    @cached_property
    def _shape(self) -> tuple[int, int, int]:
        return len(self.boxes), self.grid.size, self.inputs

    def nodes(self, cells: Bools) -> Bools:
        """All nodes of some cells: (cells,) -> (classes, cells, M)."""
        return np.broadcast_to(cells[None, :, None], self._shape).copy()

    def able(self, free: Bools) -> Bools:
        """Nodes in free cells whose pending input takes a clear path from there: (cells,) -> (classes, cells, M)."""
        out = self.nodes(free)
        for own, a in zip(out, self.boxes, strict=True):
            if a.swept is not None:
                own &= clear_paths(a.grid, a.shape, a.swept, free)
        return out

    def reach(self, target: Bools, free: Bools) -> Nodes:
        """Nodes from which `target` (classes, cells, M) is reached through free cells (cells,), level by level."""
        able = self.able(free)
        value = np.where(target & free[None, :, None], 0, -1).astype(np.int32)
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
        return Nodes(value >= 0, sets, value, int(value.max(initial=0)))

    def hold(self, safe: Bools) -> Nodes:
        """The largest set of nodes of safe cells (cells,) that can be held for ever."""
        inside = self.able(safe)
        news = np.ones(self._shape[:2], np.bool_)
        sets = np.zeros((*self._shape, -(-self.inputs // 64)), np.uint64)
        rounds = 0
        while news.any():
            rounds += 1
            lost = self._state(words_of(inside), news, inside, sets) == NONE
            inside &= ~lost
            news = lost.any(axis=-1)
        return Nodes(inside, sets, None, rounds)

    def _state(self, allowed: Words, news: Bools, todo: Bools, sets: Words) -> NDArray[np.uint8]:
        flags, look = news.view(np.uint8), todo.view(np.uint8)
        every = zip(self.boxes, look, sets, strict=True)
        return np.stack([common_inputs(a, self.kind, allowed, flags, own, s, self.threads) for a, own, s in every])
