"""Reach-while-avoid: the value function is the level at which a node is won, counted in worst-case steps to the target.

Level 0 is the target. A node (`nodes`) in a free cell is won at level l when some input takes it wholly into nodes of
levels below l, on a clear path; the inputs that do so at that moment are exactly those that go down a level, and they
are the admissible ones. Only nodes from which a newly won one can be reached are looked at again.

Where no offset depends on some axis, 64 cells are looked at together, as the bits of a machine word (`row_moves`). A
node is then a cell and, where the plant remembers, the class of the input before. Input m takes a node (k, c) into the
box of (k, m) in class c and to the class of m. Free cells are eroded by swept boxes edge by edge, axis after axis; an
edge of n rows takes log2(n) passes of 64 cells a word: AND of the set with itself, moved by 1, 2, 4, ... rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.synthesis.abstraction.cells import Abstraction, over_items, over_rows
from simgap.synthesis.games.nodes import NodeStep, least_fixed_point
from simgap.synthesis.games.row_moves import Moves, RowSystem, moves_of, with_common_sweeps, words_of_a_row
from simgap.synthesis.games.row_waves import place, settle, spread, stage_size
from simgap.synthesis.input_sets import packed_width, preferred


@dataclass(frozen=True, eq=False)
class Reach:
    """Result of the least fixed point over nodes, in the order cell, input that acts now, class of the one before.

    Attributes:
        value: worst-case steps to the target, (nodes,) int32, 0 in the target and -1 where losing.
        mask: admissible inputs, (nodes, ceil(M / 8)) uint8 as in `input_sets`, none in the target; (nodes, 0) if not
            asked.
        chosen: one admissible input of each node, (nodes,) int16, -1 in the target and where losing; (0,) if not asked.
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
        """Winning nodes, the target included, (nodes,)."""
        return self.value >= 0


def reach_avoid(
    boxes: Abstraction | Sequence[Abstraction],
    target: Bools,
    free: Bools,
    threads: int = 1,
    order: Ints | None = None,
    kind: Ints | None = None,
    late: bool = False,
    by_rows: bool = True,
    through: Bools | None = None,
    steps: int | None = None,
) -> Reach:
    """Nodes from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        boxes: abstraction of the plant, or one after a previous input of each class, on the same cells and inputs.
        target: cells to reach, (cells,), or nodes, (nodes,); those that are not free do not count.
        free: cells that a run may visit, (cells,).
        threads: rows are shared among this many threads; the result does not depend on it.
        order: all inputs from the one that is liked best, (M,), of which each node's first admissible one is recorded
            in the place of all: two bytes a node instead of a bit for each input. A controller whose rule has that
            order (`controller.least_effort`) applies the same inputs.
        kind: (M,) class of each input; all of one class when None.
        late: whether inputs act a sample after they are chosen; a node has then one of them too.
        by_rows: whether bit rows may be used where some axis allows them.
        through: cells that may be won beside the target, (cells,); all free ones outside it when None. Target cells
            among them are looked at again: those with an input into what is won have a level above 0.
        steps: the largest level, None for no end. With one step and every cell `through`, this is the controlled
            predecessor of the target.

    Raises:
        UserError: swept boxes of inputs that act at once, where no axis allows bit rows.
    """
    every = [boxes] if isinstance(boxes, Abstraction) else list(boxes)
    inputs = len(every[0].inputs)
    kind = np.zeros(inputs, np.int64) if kind is None else kind
    found = [RowSystem.of(a) for a in every] if by_rows and not late else []
    rows = [own for own in found if own is not None]
    by_rows = len(rows) == len(every)
    if not by_rows and not late and any(a.swept is not None for a in every):
        raise UserError(
            "the path between samples is checked on bit rows only, and no axis allows them",
            remedy="Use a gap that does not depend on the position, or fewer cells",
        )
    own = target.reshape(free.size, -1, 1 if target.size == free.size else len(every))
    goal = np.moveaxis(np.broadcast_to(own & free[:, None, None], (*own.shape[:2], len(every))), 2, 0)
    if by_rows:
        about = with_common_sweeps(rows), kind, goal[:, :, 0], free, threads, order, through, steps
        levels, sets, chosen = reach_by_rows(*about)
        value, mask, chosen = levels.reshape(-1), sets.reshape(levels.size, sets.shape[2]), chosen.reshape(-1)
    else:
        step = NodeStep(every, kind, late, threads, often=True)
        goal = np.broadcast_to(goal, step.shape)
        able = step.able(every, free) & (~goal if through is None else through[:, None])
        levels, sets = least_fixed_point(step, goal, able, steps)
        value, mask = step.flat(levels), step.flat(sets)
        chosen = np.empty(0, np.int16) if order is None else preferred(mask, order)
        mask = mask if order is None else mask[:, :0]
    return Reach(value, mask, chosen, int(value.max(initial=0)), "bit_rows" if by_rows else "table")


Rows = NDArray[np.uint64]


def erode(sets: Rows, lengths: Ints, periodic: Ints, box: Ints) -> Rows:
    """Cells at which a box of extents (4,), three row axes and then along the rows, can begin and lie in the set.

    Sets are (rows, words), with `lengths` (3,) rows along the axes. Beyond an axis that ends there are no cells;
    periodic axes wrap.
    """
    shaped = _and_of_moved(sets, int(box[3]), _moved_along_rows).reshape(*lengths, -1)
    for axis in range(3):
        shaped = _and_of_moved(shaped, int(box[axis]), partial(_moved, axis=axis, wraps=bool(periodic[axis])))
    return shaped.reshape(sets.shape)


def _and_of_moved(sets: Rows, extent: int, moved: Callable[[Rows, int], Rows]) -> Rows:
    """AND of a set with itself, `moved` by 1 to extent - 1, by doubling."""
    have = 1
    while have < extent:
        by = min(have, extent - have)
        sets = sets & moved(sets, by)
        have += by
    return sets


def _moved(sets: Rows, by: int, axis: int, wraps: bool) -> Rows:
    """Entry i + by of an axis in the place of entry i."""
    out = np.roll(sets, -by, axis)
    if not wraps:
        np.moveaxis(out, axis, 0)[max(0, sets.shape[axis] - by) :] = 0
    return out


def _moved_along_rows(sets: Rows, by: int) -> Rows:
    """Bit j + by of a row in the place of bit j."""
    words, bits = divmod(by, 64)
    low = _moved(sets, words, 1, False)
    if not bits:
        return low
    return low >> np.uint64(bits) | _moved(low, 1, 1, False) << np.uint64(64 - bits)


def pack_rows(cells: Bools, base: Ints, stride: int, count: int, words: int) -> Rows:
    """Flags of cells as rows of bits, (rows, words); cell j of a row is `base[row] + j stride`."""
    bits = np.zeros((len(base), words), np.uint64)
    for j in range(count):
        bits[:, j >> 6] |= cells[base + j * stride].astype(np.uint64) << np.uint64(j & 63)
    return bits


ENTRIES = 1 << 16
"""Words of cells found with an input that there is room for at first, for each thread."""


class Levels:
    """The sets of nodes while they grow.

    Attributes:
        news: (classes, slabs) whether a slab won cells at the last level.
    """

    def __init__(self, moves: Moves, goal: Rows, todo: Rows, clear: Rows, threads: int) -> None:
        """From the target and what is to be won, (classes, rows, words), and free cells eroded by swept boxes."""
        rows, words, widest = moves.size.tolist()
        self._moves, self._clear, self._threads = moves, clear, threads
        self._won = goal.reshape(len(goal), -1, rows * words)
        self._todo = todo.reshape(-1, rows * words)
        self._made = np.zeros((len(moves.block_class), rows * words), np.uint64)
        self.news: NDArray[np.uint8] = np.any(self._won, axis=2).astype(np.uint8)
        self._fresh = np.zeros((threads, *self._todo.shape), np.uint64)
        self._ends = np.zeros((threads, self._todo.size), np.int64)
        self._count = np.zeros((threads, 1), np.int64)
        self._entries = np.empty((threads, ENTRIES, 2), np.uint64)
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
        return int(spread(*sets, *space, self._threads, blocks[worker]))

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
        found = self._moves, self._fresh, self._ends, placed
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
    order: Ints | None = None,
    through: Bools | None = None,
    steps: int | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.int16]]:
    """Levels and admissible inputs of nodes.

    Args:
        systems: boxes after a previous input of each class, over common sizes of swept boxes.
        kind: (M,) class of each input.
        target: (classes, cells), or (cells,) for all classes; those that are not free do not count. free: (cells,).
        threads: slabs are shared among this many threads; the result does not depend on it.
        order: inputs (M,) of which the first admissible one alone is recorded.
        through, steps: as in `reach_avoid`.

    Returns:
        value (cells, classes), mask (cells, classes, bytes), with an order (cells, classes, 0), and that one input
        (cells, classes), -1 for none, without an order (0, 0).
    """
    s, classes = systems[0], len(systems)
    one = np.empty(0, np.int64) if order is None else order
    moves = moves_of(systems, kind)
    words = words_of_a_row(systems)

    def packed(cells: Bools) -> Rows:
        return pack_rows(cells, s.base, s.stride, s.count, words)

    goal = np.broadcast_to(target & free, (classes, free.size))
    todo = [packed(free & (~own if through is None else through)) for own in goal]
    value = np.where(goal.T, 0, -1).astype(np.int32)
    mask = np.zeros((free.size, classes, packed_width(len(kind)) if order is None else 0), np.uint8)
    chosen = np.full((0, 0) if order is None else value.shape, -1, np.int16)
    levels = Levels(moves, np.stack([packed(own) for own in goal]), np.stack(todo), _clear(s, packed(free)), threads)
    level = 0
    while levels.news.any() and level != steps:
        level += 1
        levels.spread()
        levels.settle(level, s.base, s.stride, one, (value, mask, chosen))
    return value, mask, chosen


def _clear(s: RowSystem, allowed: Rows) -> Rows:
    """The free cells eroded by each swept box, flat (shapes, rows, words) with an empty row in front and behind."""
    shapes, (rows, words) = s.swept_shapes, allowed.shape
    flat = np.zeros((len(shapes) * rows + 2, words), np.uint64)
    for clear, box in zip(flat[1:-1].reshape(len(shapes), rows, words), shapes, strict=True):
        clear[:] = erode(allowed, s.lengths, s.periodic, box)
    return flat.reshape(-1)
