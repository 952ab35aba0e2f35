"""Reach-while-avoid: the value function is the level at which a node is won, counted in worst-case steps to the target.

Level 0 is the target. A node (`nodes`) in a free cell is won at level l when some input takes it wholly into nodes of
levels below l, on a clear path; the inputs that do so at that moment are exactly those that go down a level, and they
are the admissible ones. Only nodes from which a newly won one can be reached are looked at again. Where some axis
allows it, 64 cells are looked at together (`reach_rows`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.games.nodes import NodeStep, least_fixed_point
from simgap.synthesis.games.reach_rows import reach_by_rows
from simgap.synthesis.games.row_moves import RowSystem, with_common_sweeps
from simgap.synthesis.input_sets import preferred

Backend = Literal["auto", "bit_rows", "table"]


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
    backend: Backend = "auto",
    order: Ints | None = None,
    kind: Ints | None = None,
    late: bool = False,
) -> Reach:
    """Nodes from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        boxes: abstraction of the plant, or one after a previous input of each class, on the same cells and inputs.
        target: cells to reach, (cells,), or nodes, (nodes,); those that are not free do not count.
        free: cells that a run may visit, (cells,).
        threads: rows are shared among this many threads; the result does not depend on it.
        backend: `bit_rows` where some axis allows it and else `table`, unless one is asked for.
        order: all inputs from the one that is liked best, (M,), of which each node's first admissible one is recorded
            in the place of all: two bytes a node instead of a bit for each input. A controller whose rule has that
            order (`controller.least_effort`) applies the same inputs.
        kind: (M,) class of each input; all of one class when None.
        late: whether inputs act a sample after they are chosen; a node has then one of them too.

    Raises:
        UserError: `bit_rows` asked for where every axis matters.
    """
    every = [boxes] if isinstance(boxes, Abstraction) else list(boxes)
    inputs = len(every[0].inputs)
    kind = np.zeros(inputs, np.int64) if kind is None else kind
    found = [] if late or backend == "table" else [RowSystem.of(a) for a in every]
    rows = [own for own in found if own is not None]
    by_rows = len(rows) == len(every)
    if not by_rows and backend == "bit_rows":
        raise UserError(
            "no axis allows bit rows: every offset depends on it, it is periodic, or the boxes differ too much",
            remedy="Use the table backend",
        )
    if not by_rows and not late and any(a.swept is not None for a in every):
        raise UserError(
            "the path between samples is checked on bit rows only, and no axis allows them",
            remedy="Use a gap that does not depend on the position, or fewer cells",
        )
    if by_rows:
        goal = target if target.size == free.size else target.reshape(free.size, -1).all(axis=1)
        levels, sets, chosen = reach_by_rows(with_common_sweeps(rows), kind, goal & free, free, threads, order)
        value, mask, chosen = levels.reshape(-1), sets.reshape(levels.size, sets.shape[2]), chosen.reshape(-1)
    else:
        step = NodeStep(every, kind, late, threads, often=True)
        own = target.reshape(free.size, -1, 1 if target.size == free.size else len(every))
        goal = np.broadcast_to(own & free[:, None, None], (free.size, step.shape[2], len(every)))
        levels, sets = least_fixed_point(step, np.moveaxis(goal, 2, 0), step.able(every, free))
        value, mask = step.flat(levels), step.flat(sets)
        chosen = np.empty(0, np.int16) if order is None else preferred(mask, order)
        mask = mask if order is None else mask[:, :0]
    return Reach(value, mask, chosen, int(value.max(initial=0)), "bit_rows" if by_rows else "table")
