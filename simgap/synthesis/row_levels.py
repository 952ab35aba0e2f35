"""The levels of reach-while-avoid on slabs of bits: the sets that the kernels of `row_waves` share among threads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.synthesis.row_moves import Moves
from simgap.synthesis.row_settle import place, settle
from simgap.synthesis.row_waves import spread, stage_size
from simgap.synthesis.threads import over_items, over_rows

Ints = NDArray[np.int64]
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
