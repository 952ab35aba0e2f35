"""Reach-while-avoid on bit rows: 64 cells a machine word where no offset depends on some axis (`row_moves`).

A node is a cell and, where the plant remembers, the class of the input before. Input m takes a node (k, c) into the box
of (k, m) in class c and to the class of m.

Free cells are eroded by swept boxes edge by edge, axis after axis; an edge of n rows takes log2(n) passes of 64
cells a word: AND of the set with itself, moved by 1, 2, 4, ... rows. Boxes share the passes that they have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.late import njit
from simgap.synthesis.games.row_moves import Moves, RowSystem, moves_of, words_of_a_row
from simgap.synthesis.games.row_waves import place, settle, spread, stage_size
from simgap.synthesis.games.threads import over_items, over_rows
from simgap.synthesis.input_sets import packed_width

Rows = NDArray[np.uint64]


class BoxErosion:
    """Erodes sets of rows (rows, words) by many boxes (k, 4) of extents: three row axes, then along the rows.

    The result for a box is anchored at its lower corner: a cell is in it when the whole box that starts there lies in
    the set. Beyond an axis that ends there are no cells; periodic axes wrap.
    """

    def __init__(self, lengths: Ints, periodic: Ints, boxes: Ints) -> None:
        self._axes = lengths, periodic
        self._boxes = boxes[:, [3, 0, 1, 2]]  # along the rows first: most boxes share that pass
        order = np.lexsort(self._boxes.T[::-1])
        starts = np.flatnonzero(np.diff(self._boxes[order, 0])) + 1
        self._groups = np.split(order, starts) if len(order) else []

    def __call__(self, source: Rows, eroded: Rows, grew: NDArray[np.uint8], threads: int = 1) -> None:
        """Write the erosions (k, rows, words) of `source`, and `grew` (k, rows) = 1 where they are new."""
        over_items(lambda group: self._erode(group, source, eroded, grew), self._groups, threads)

    def _erode(self, group: Ints, source: Rows, eroded: Rows, grew: NDArray[np.uint8]) -> None:
        stage, spare, last = [np.empty_like(source) for _ in range(4)], np.empty_like(source), np.zeros(4, np.int64)
        erode_along_rows(source, self._boxes[group[0], 0], stage[0])
        for s in group:
            box, stale = self._boxes[s], False
            for k in range(1, 4):
                stale = stale or box[k] != last[k]
                if stale:
                    _erode_axis(*self._axes, k - 1, box[k], stage[k - 1], stage[k], spare)
            last = box
            _replace(stage[3], eroded[s], grew[s])


@njit(cache=True, nogil=True)
def _erode_axis(lengths, periodic, axis, extent, source, out, spare):  # type: ignore[no-untyped-def]
    """out row i = AND of rows i .. i + extent - 1 of `source` along one axis, by doubling; `spare` is overwritten."""
    n, inner = lengths[axis], source.shape[1]
    for j in range(axis + 1, 3):
        inner *= lengths[j]
    a, b = out.reshape(-1), spare.reshape(-1)
    a[:] = source.reshape(-1)
    have = 1
    while have < extent:
        by = min(have, extent - have)
        b[:] = a
        for outer in range(a.size // (n * inner)):
            first = outer * n * inner
            for i in range(n):
                here, there = first + i * inner, first + (i + by) % n * inner
                if i + by < n or periodic[axis]:
                    for q in range(inner):
                        a[here + q] = b[here + q] & b[there + q]
                else:
                    a[here : here + inner] = 0
        have += by


@njit(cache=True, nogil=True)
def _replace(new, old, grew):  # type: ignore[no-untyped-def]
    """old = new, with a flag for every row that differs."""
    for r in range(new.shape[0]):
        grew[r] = 0
        for w in range(new.shape[1]):
            if old[r, w] != new[r, w]:
                old[r, w] = new[r, w]
                grew[r] = 1


def dilate(flags: NDArray[np.uint8], lengths: Ints, periodic: Ints, lower: Ints, upper: Ints) -> NDArray[np.uint8]:
    """Rows r such that some flagged row lies in r + [lower, upper] along every row axis, (rows,)."""
    out = flags.reshape(tuple(lengths))
    for axis in range(3):
        out = _dilate_axis(np.moveaxis(out, axis, 0), bool(periodic[axis]), int(lower[axis]), int(upper[axis]), axis)
    return np.ascontiguousarray(out.reshape(-1))


def _dilate_axis(flags: NDArray[np.uint8], wraps: bool, lower: int, upper: int, axis: int) -> NDArray[np.uint8]:
    n = len(flags)
    out = np.zeros_like(flags)
    if wraps and upper - lower >= n:
        lower, upper = 0, n - 1
    for by in range(lower, upper + 1):
        if wraps:
            out |= np.roll(flags, -by, axis=0)
        elif abs(by) < n:
            out[max(0, -by) : n - max(0, by)] |= flags[max(0, by) : n + min(0, by)]
    return np.moveaxis(out, 0, axis)


@njit(cache=True, nogil=True)
def erode_along_rows(bits, width, out):  # type: ignore[no-untyped-def]
    """out bit j = AND of bits j .. j + width - 1 of the same row; beyond the row there are no cells."""
    words = bits.shape[1]
    for r in range(bits.shape[0]):
        for w in range(words):
            total = bits[r, w]
            for k in range(1, width):
                total &= _shifted(bits, r, w, k, words)
            out[r, w] = total


@njit(cache=True, nogil=True)
def _shifted(bits, r, w, by, words):  # type: ignore[no-untyped-def]
    """Word `w` of row `r` moved so that its bit j is bit j + by of the row; zero beyond both ends."""
    word, bit = w + (by >> 6), np.uint64(by & 63)
    low = bits[r, word] if 0 <= word < words else np.uint64(0)
    if bit == 0:
        return low
    high = bits[r, word + 1] if 0 <= word + 1 < words else np.uint64(0)
    return (low >> bit) | (high << (np.uint64(64) - bit))


@njit(cache=True, nogil=True)
def pack_rows(cells, base, stride, count, bits):  # type: ignore[no-untyped-def]
    """Pack flags of cells (flat uint8) into rows (rows, words) uint64; cell j of a row is `base[row] + j stride`."""
    for r in range(base.size):
        for w in range(bits.shape[1]):
            bits[r, w] = np.uint64(0)
        for j in range(count):
            if cells[base[r] + j * stride]:
                bits[r, j >> 6] |= np.uint64(1) << np.uint64(j & 63)


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
