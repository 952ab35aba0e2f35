"""Reach-while-avoid: the value function is the level at which a cell is won, counted in worst-case steps to the target.

Level 0 is the target. A free cell is won at level l when some input's box lies wholly in the cells of levels below l;
the inputs that do so at that moment are exactly those that go down a level, and they are the admissible ones. Only
cells from which a newly won cell can be reached are looked at again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.bits import preferred

Backend = Literal["auto", "bit_rows", "table"]


@dataclass(frozen=True, eq=False)
class Reach:
    """What the fixed point found.

    Attributes:
        value: worst-case steps to the target, (cells,) int32, 0 in the target and -1 where losing.
        mask: admissible inputs, (cells, ceil(M / 8)) uint8 as in `bits`, none in the target; (cells, 0) if not asked.
        chosen: one admissible input of each cell, (cells,) int16, -1 in the target and where losing; (0,) if not asked.
        steps: the largest value.
        backend: `bit_rows` or `table`.
    """

    value: NDArray[np.int32]
    mask: NDArray[np.uint8]
    chosen: NDArray[np.int16]
    steps: int
    backend: str

    @property
    def winning(self) -> NDArray[np.bool_]:
        """Winning cells, the target included, (cells,)."""
        return self.value >= 0


def reach_avoid(
    abstraction: Abstraction,
    target: NDArray[np.bool_],
    free: NDArray[np.bool_],
    threads: int = 1,
    backend: Backend = "auto",
    masks: bool = True,
    order: NDArray[np.int64] | None = None,
) -> Reach:
    """Cells from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        abstraction: cells, inputs and post.
        target: cells to reach, (cells,); those that are not free do not count.
        free: cells that a run may visit, (cells,).
        threads: rows are shared among this many threads; the result does not depend on it.
        backend: `bit_rows` where some axis allows it and else `table`, unless one is asked for.
        masks: whether to record all admissible inputs.
        order: all inputs from the one that is liked best, (M,), of which each cell's first admissible one is recorded
            in the place of all: two bytes a cell instead of a bit for each input. A controller whose rule has that
            order (`controller.least_effort`) applies the same inputs.

    Raises:
        UserError: `bit_rows` asked for where every axis matters.
    """
    from simgap.synthesis.reach_rows import RowSystem, reach_by_rows
    from simgap.synthesis.reach_table import reach_by_table

    rows = None if backend == "table" else RowSystem.of(abstraction)
    if rows is None and backend == "bit_rows":
        raise UserError(
            "no axis allows bit rows: every offset depends on it, it is periodic, or the boxes differ too much",
            remedy="Use the table backend",
        )
    if rows is None and abstraction.swept is not None:
        raise UserError(
            "the path between samples is checked on bit rows only, and no axis allows them",
            remedy="Use a gap that does not depend on the position, or fewer cells",
        )
    if rows is not None:
        kind = np.zeros(len(abstraction.inputs), np.int64)
        levels, sets, one = reach_by_rows([rows], kind, target & free, free, threads, masks, order)
        value, mask, chosen = levels[:, 0], sets[:, 0], one[:, :1].reshape(-1)
    else:
        solve = (target & free).astype(np.uint8), free.astype(np.uint8)
        value, mask = reach_by_table(abstraction, *solve, threads, masks or order is not None)
        chosen = np.empty(0, np.int16) if order is None else preferred(mask, order)
        mask = mask if order is None else mask[:, :0]
    return Reach(value, mask, chosen, int(value.max(initial=0)), "table" if rows is None else "bit_rows")
