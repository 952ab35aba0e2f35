"""Reach a box, and stay in it for ever.

The part of the target that can be held is its largest controlled invariant subset W. From every cell that reaches W in
bounded time the promise is kept by going there and then staying: below level 0 a controller applies inputs that go down
a level, in W those that keep every successor in W. Whatever is in the target for ever after a bounded number of steps
is in W by then, so no cell is lost that can promise this.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Bools, Floats, Ints
from simgap.specifications.base import EARLY, STUCK, Game, Monitor, Run, Words
from simgap.specifications.reaching import LATE, Reaching, Toward
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space

STAYED, LEFT = "reached the target and stayed", "left the target again"


class ReachAndStay(Reaching):
    """Reach the target, avoid the obstacles, and stay in the target for ever after."""

    kind: Literal["reach_and_stay"] = Field(description="Reach the target, avoid the obstacles, stay in the target.")

    then: ClassVar[str] = ", stay there for ever"
    words: ClassVar[Words] = Words(
        runs="Runs into the target",
        caption="Runs of the controller made for the nominal model alone and of the gap-aware one in the simulator (in "
        "colour), and from the same starts on the nominal model (grey, dashed).",
        kept="in the target and still there at the end",
        allowed="free cells",
        promise="reaches the target and stays there for ever",
        violated="touches something or leaves the target",
        limits="arena",
    )

    def solve(self, game: Game) -> Solution:
        """The largest part of the target that can be held, and the cells from which it is reached."""
        target, free = self.sets(game)
        held = game.invariant(target)
        return game.reach(held.served, free).followed_by(held)

    def monitor(self, space: Space, solution: Solution) -> Monitor:
        """Monitor of arrival in the held part of the target, of staying in the target and touching nothing."""
        return Staying(space, self.goal_box(space), self.surroundings(space), solution)


class Staying(Toward):
    """A run goes on in the target until its last sample."""

    def over_each(self, x: Floats, measured: Floats) -> Bools:
        """Runs go on, whatever `x` and `seen`: (n, nx), (n, nx) -> (n,)."""
        return np.zeros(len(x), np.bool_)

    def unbroken(self, run: Run, levels: Ints) -> Bools:
        """Before the first sample outside the target after one in its held part: levels (k + 1,) -> (k + 1,)."""
        held = np.maximum.accumulate(levels == 0)
        left: Bools = np.logical_or.accumulate(held & ~self.in_target(run.x))
        return ~left

    def ended(self, run: Run, levels: Ints, steps: int) -> tuple[str, bool]:
        """End of a run that touched nothing, kept if it stays in the target from its held part on; levels (k + 1,)."""
        arrived = np.flatnonzero(levels == 0)
        if len(arrived) == 0:
            return (STUCK if run.stuck else LATE), False
        if not self.in_target(run.x[arrived[0] :]).all():
            return LEFT, False
        if run.stuck:
            return STUCK, False
        return (STAYED, True) if len(run.inputs) >= steps else (EARLY, False)
