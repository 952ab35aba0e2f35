"""Reach a box, and touch nothing before."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Bools, Floats, Ints
from simgap.specifications.base import STUCK, Game, Monitor, Run, Words
from simgap.specifications.reaching import LATE, Reaching, Toward
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space

REACHED, BESIDE = "reached the target", "ended beside the target"


class ReachAvoid(Reaching):
    """Reach the target and avoid the obstacles until then; a run ends in the target."""

    kind: Literal["reach_avoid"] = Field(description="Reach the target and avoid the obstacles until then.")

    swept_boxes: ClassVar[bool] = True
    holds: ClassVar[bool] = False
    words: ClassVar[Words] = Words(
        runs="Runs in the arena",
        caption="Runs of the controller made for the nominal model alone (left) and of the gap-aware one (right) in "
        "the simulator, and from the same starts on the nominal model (grey, dashed).",
        kept="in the target without touching anything",
        allowed="free cells",
        promise="reaches the target",
        violated="touches something",
        limits="arena",
    )

    def solve(self, game: Game) -> Solution:
        """The least fixed point, its value function and all inputs that go down a level."""
        return game.reach(*self.sets(game))

    def monitor(self, space: Space, solution: Solution) -> Monitor:
        """Monitor of arrival in the target without touching anything on the path."""
        return Arriving(space, self.goal_box(space), self.surroundings(space), solution)


class Arriving(Toward):
    """A run ends in a cell of the target."""

    def over(self, x: Floats, measured: Floats) -> bool:
        """A run ends where the controller knows that it has arrived: (nx,), (nx,)."""
        return self.arrived(measured)

    def over_each(self, x: Floats, measured: Floats) -> Bools:
        """The same for many runs: (n, nx), (n, nx) -> (n,)."""
        cells = self.solution.grid.index(measured)
        return np.where(cells >= 0, self.solution.ended[cells], False)

    def ended(self, run: Run, levels: Ints, steps: int) -> tuple[str, bool]:
        """Arrived, without an input, or still moving; levels (k + 1,)."""
        if levels[-1] == 0:
            arrived = bool(self.in_target(run.x[-1:])[0])
            return (REACHED, True) if arrived else (BESIDE, False)
        return (STUCK if run.stuck else LATE), False
