"""Specifications that reach a target among obstacles, and then end (`reach_avoid`) or stay in it (`reach_and_stay`).

The monitor records the level of the value function and the distance to obstacles and walls (`arena`).

The part of the target that can be held is its largest controlled invariant subset W. From every cell that reaches W in
bounded time the promise is kept by going there and then staying: below level 0 a controller applies inputs that go down
a level, in W those that keep every successor in W. Whatever is in the target for ever after a bounded number of steps
is in W by then, so no cell is lost that can promise this.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Bools, Floats, Ints
from simgap.config.base import Interval
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.specifications.arena import Arena, Surroundings, until_touch
from simgap.specifications.base import (
    EARLY,
    STUCK,
    Game,
    Look,
    Monitor,
    Outcome,
    Plane,
    Run,
    Verdict,
    Words,
    projected,
    rectangle,
)
from simgap.specifications.solution import Solution
from simgap.specifications.space import (
    KEY,
    Space,
    cells_within,
    covered,
    in_copies,
    known,
    partial_box,
    unbounded,
)

LATE = "out of time"


@dataclass(frozen=True, eq=False)
class Toward(Monitor):
    """Judges runs towards a target.

    Attributes:
        space: the states; target: the box to be in, infinite along states that do not matter.
        surroundings: what must not be touched; solution: of the controller, whose value falls with every step.
    """

    space: Space
    target: Box
    surroundings: Surroundings
    solution: Solution

    measures_clearance = True

    def clearance(self, path: Floats) -> float:
        """Least distance to obstacles and walls along a path (k, nx)."""
        return self.surroundings.least(path)

    def in_target(self, x: Floats) -> Bools:
        """True where states are in the target's box: (n, nx) -> (n,); along periodic states in any of its copies."""
        return in_copies(self.space, self.target, x)

    def judge(self, run: Run, steps: int) -> Verdict:
        """Cut the run where it touches something, or ask how it ended."""
        run, hit = until_touch(run, self.surroundings)
        levels = self.solution.levels(run.measured, run.memory)
        end, kept = (self.surroundings.touched, False) if hit else self.ended(run, levels, steps)
        safe = (np.arange(len(run.x)) < len(run.x) - hit) & self.unbroken(run, levels)
        figures = self.measured(run, levels, hit)
        return Verdict(Outcome(end, kept, len(run.inputs), figures), run, safe)

    @abstractmethod
    def ended(self, run: Run, levels: Ints, steps: int) -> tuple[str, bool]:
        """End of a run that touched nothing, and whether it was asked for; levels (k + 1,)."""

    def unbroken(self, run: Run, levels: Ints) -> Bools:
        """Samples up to which nothing but a touch could have violated what was asked for: (k + 1,)."""
        return np.ones(len(run.x), np.bool_)

    def measured(self, run: Run, levels: Ints, hit: bool) -> dict[str, float]:
        """Steps until the target, steps that left the certified box, and the least clearance; levels (k + 1,)."""
        arrived = np.flatnonzero(levels == 0)
        last = int(arrived[0]) if len(arrived) else len(levels) - 1 - hit
        falls = (levels[1 : last + 1] >= 0) & (levels[1 : last + 1] < levels[:last])
        near = run.clearance if run.clearance is not None else np.array([np.inf])
        return {
            "to_target": float(arrived[0]) if len(arrived) else np.nan,
            "climbs": float((~falls).sum()),
            "clearance": float(near.min()),
        }

    def summary(self, outcomes: Sequence[Outcome]) -> dict[str, Any]:
        """Steps to the target of the runs that kept the specification, and the worst over all of them."""
        near = min((o.figures["clearance"] for o in outcomes), default=np.inf)
        key = "least_clearance" if self.surroundings.round else "least_clearance_in_widths_of_X"
        return {
            "steps_to_target": [int(o.figures["to_target"]) for o in outcomes if o.kept],
            "steps_that_left_the_certified_box": int(sum(o.figures["climbs"] for o in outcomes)),
            key: near,
        }


NOT_FREE = "every cell of the target is inside an obstacle or too near to one or to a wall"


class Reaching(Arena):
    """Reach a box without touching others."""

    target: dict[str, Interval] = Field(min_length=1)
    """The box to reach; states not named are free."""

    then: ClassVar[str] = ""
    """Words that its sentence adds after naming the target."""

    def region(self, space: Space) -> Box:
        """The arena; obstacles and target must lie in it."""
        arena = super().region(space)
        known(self.target, space.states, "target")
        within = unbounded(arena, space.wrapping(arena))
        goal = self.goal_box(space)
        bounded = np.isfinite(goal.lo)
        if np.any(bounded & ((goal.lo < within.lo) | (goal.hi > within.hi))):
            raise UserError("the target lies outside the arena", key=f"{KEY}.target", remedy="Move it inside")
        self._refuse_covered(space, arena)
        return arena

    def _refuse_covered(self, space: Space, arena: Box) -> None:
        """Refuse a target that has no free state, whatever the cells are."""
        keep, wraps, goal = space.vector(self.clearance), list(space.wrapping(arena)), self.goal_box(space)
        lo, hi, period = arena.lo + keep, arena.hi - keep, np.diag(arena.hi - arena.lo)
        if np.any(lo >= hi):
            return  # nothing of the arena is left, which is told of the clearance
        lo[wraps], hi[wraps] = -np.inf, np.inf
        lo, hi = np.maximum(goal.lo, lo), np.minimum(goal.hi, hi)
        lo, hi = np.where(np.isfinite(lo), lo, arena.lo), np.where(np.isfinite(hi), hi, arena.hi)
        shifts = [np.zeros(space.size), *period[wraps], *-period[wraps]]
        near = [Box(b.lo - keep + s, b.hi + keep + s) for b in self.boxes(space) for s in shifts]
        if np.any(lo >= hi) or covered(Box(lo, hi), near):
            raise UserError(NOT_FREE, key=f"{KEY}.target", remedy="Move the target, or lower the clearance")

    def goal_box(self, space: Space) -> Box:
        """The target, infinite along the states that it does not name."""
        return partial_box(self.target, space.states)

    def goal(self, game: Game) -> Bools:
        """Cells whose every state is in the target, whatever the measurement error: (cells,) bool.

        Raises:
            UserError: when no cell fits into the target.
        """
        box, grid = self.goal_box(game.space), game.grid
        lo, hi = box.lo + game.error, box.hi - game.error
        for j, name in enumerate(game.space.states):
            room, ends = hi[j] - lo[j], {name: (lo[j], hi[j])}
            if not (room > 0 and cells_within(grid, partial_box(ends, game.space.states)).any()):
                raise UserError(
                    f"no cell fits into the target along {name}: it leaves {room:.6g}, a cell is {2 * grid.h[j]:.6g} "
                    "wide",
                    key=f"{KEY}.target",
                    remedy=f"Cells of {room / 2:.6g} or less would do (`synthesis.cells`), or a larger target"
                    if room > 0
                    else "The measurement error is as large as the target: make the target larger",
                )
        return cells_within(grid, Box(lo, hi))

    def sets(self, game: Game) -> tuple[Bools, Bools]:
        """Cells of the target that are free, and free cells: (cells,) bool each.

        Raises:
            UserError: when there is none of the former.
        """
        free = self.free(game.space, game.grid, game.stray + game.error)
        target = self.goal(game) & free
        if not target.any():
            raise UserError(NOT_FREE, key=f"{KEY}.target", remedy="Move the target, or lower the clearance")
        return target, free

    def sentence(self, space: Space) -> str:
        """'reach ... and avoid ...'."""
        target = ", ".join(space.interval(name, ends) for name, ends in self.target.items())
        return f"reach {target}{self.then}{self.avoiding()}{self.clear_of(space)}"

    def plane(self, space: Space) -> Plane | None:
        """Arena, obstacles and target on the floor of a body that drives."""
        plane = super().plane(space)
        if plane is None:
            return None
        return replace(plane, target=projected(self.goal_box(space), self.region(space), plane.axes[:2]))

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """Target, obstacles and the border of the arena."""
        target, (face, edge) = projected(self.goal_box(space), self.region(space), shown), look.target
        rectangle(axes, target, facecolor=face, edgecolor=edge, lw=1.0, label="target")
        super().draw(axes, space, shown, look)


REACHED, BESIDE = "reached the target", "ended beside the target"


class ReachAvoid(Reaching):
    """Reach the target and avoid the obstacles until then; a run ends in the target."""

    kind: Literal["reach_avoid"]
    """Reach the target and avoid the obstacles until then."""

    swept_boxes: ClassVar[bool] = True
    holds: ClassVar[bool] = False
    words: ClassVar[Words] = Words(
        runs="Runs in the arena",
        caption="Runs of the controller made for the nominal model alone (left) and of the gap-aware one (right) in "
        "the simulator, and from the same starts on the nominal model (grey, dashed).",
        kept="in the target without touching anything",
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
        """A run ends where the controller knows that it has arrived, whatever is pending: (nx,), (nx,)."""
        cell = self._find(measured)
        return cell >= 0 and self._ended[cell]

    @cached_property
    def _find(self) -> Any:
        return self.solution.grid.finder()

    @cached_property
    def _ended(self) -> list[bool]:
        return self.solution.ended.tolist()  # a list answers faster than an array, one element at a time

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


STAYED, LEFT = "reached the target and stayed", "left the target again"


class ReachAndStay(Reaching):
    """Reach the target, avoid the obstacles, and stay in the target for ever after."""

    kind: Literal["reach_and_stay"]
    """Reach the target, avoid the obstacles, stay in the target."""

    then: ClassVar[str] = ", stay there for ever"
    words: ClassVar[Words] = Words(
        runs="Runs into the target",
        caption="Runs of the controller made for the nominal model alone and of the gap-aware one in the simulator (in "
        "colour), and from the same starts on the nominal model (grey, dashed).",
        kept="in the target and still there at the end",
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
        """Runs go on, whatever is measured: (n, nx), (n, nx) -> (n,)."""
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
