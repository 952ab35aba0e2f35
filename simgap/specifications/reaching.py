"""Base of the specifications that reach a target among obstacles: their keys, their sets, their picture."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from simgap.arrays import Bools, Floats
from simgap.config.base import Interval, NotNegative
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.specifications.base import Game, Specification
from simgap.specifications.picture import Look, Plane, projected, rectangle
from simgap.specifications.regions import (
    KEY,
    cells_meeting,
    cells_within,
    covered,
    grown,
    inner_box,
    known,
    partial_box,
    unbounded,
)
from simgap.specifications.space import Space
from simgap.specifications.toward import Surroundings, on_floor

NOT_FREE = "every cell of the target is inside an obstacle or too near to one or to a wall"
RADIUS = 0.15
"""Radius of a footprint to draw where a case gives no clearance."""


class Reaching(Specification):
    """Reach a box without touching others."""

    arena: dict[str, Interval] = Field(
        default_factory=dict, description="For each state the interval never to leave; states not named keep all of X."
    )
    obstacles: tuple[dict[str, Interval], ...] = Field(
        (), description="Boxes to avoid; an obstacle holds for all values of the states it does not name."
    )
    target: dict[str, Interval] = Field(min_length=1, description="The box to reach; states not named are free.")
    clearance: dict[str, NotNegative] = Field(
        default_factory=dict,
        description="For a state, how far to keep from walls and obstacles (half the footprint), in its unit.",
    )

    between_samples: ClassVar[bool] = True
    then: ClassVar[str] = ""
    """What its sentence says of the target after naming it."""

    def region(self, space: Space) -> Box:
        """The arena; obstacles and target must lie in it."""
        arena = inner_box(self.arena, space.states, space.box, "arena")
        for number, named in enumerate(self.obstacles):
            known(named, space.states, f"obstacles[{number}]")
        known(self.target, space.states, "target")
        known(self.clearance, space.states, "clearance")
        within = unbounded(arena, space.wrapping(arena))
        for number, box in enumerate(self.boxes(space)):
            if not np.all((box.lo < within.hi) & (box.hi > within.lo)):
                raise UserError("the obstacle lies outside the arena", key=f"{KEY}.obstacles[{number}]")
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

    def on_floor(self, space: Space) -> bool:
        """True if obstacles and clearance are about x and y alone: swept boxes do not say which headings a path has."""
        return space.pose is not None and on_floor(self.boxes(space), space.vector(self.clearance), space.pose)

    def boxes(self, space: Space) -> tuple[Box, ...]:
        """The obstacles, infinite along the states that they do not name."""
        return tuple(partial_box(named, space.states) for named in self.obstacles)

    def goal_box(self, space: Space) -> Box:
        """The target, infinite along the states that it does not name."""
        return partial_box(self.target, space.states)

    def surroundings(self, space: Space) -> Surroundings:
        """Obstacles and walls with the clearance that runs keep from them."""
        return Surroundings.of(space, self.boxes(space), self.region(space), space.vector(self.clearance))

    def free(self, space: Space, grid: Grid, margin: Floats) -> Bools:
        """Cells that keep the clearance and a margin from every obstacle and, along axes that end, the walls.

        The margin is (nx,), or (2, nx): from obstacles, and from walls.
        """
        both = np.broadcast_to(space.vector(self.clearance) + margin, (2, space.size))
        keep, walls = both
        lo, hi = grid.box.lo + walls, grid.box.hi - walls
        lo[list(grid.periodic)], hi[list(grid.periodic)] = -np.inf, np.inf
        if np.any(lo >= hi):
            raise UserError("the clearance leaves no room in the arena", key=f"{KEY}.clearance")
        free = cells_within(grid, Box(lo, hi))
        for box in self.boxes(space):
            free &= ~cells_meeting(grid, grown(box, keep))
        return free

    def goal(self, game: Game) -> Bools:
        """Cells whose every state is in the target, whatever the measurement error: (cells,) bool.

        Raises:
            UserError: when no cell fits into the target.
        """
        box, grid = self.goal_box(game.space), game.grid
        lo, hi = box.lo + game.error, box.hi - game.error
        for j, name in enumerate(game.space.states):
            room = hi[j] - lo[j]
            if np.isfinite(room) and (room <= 0 or not cells_within(grid, _slab(j, lo, hi)).any()):
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

    def limits(self, space: Space) -> Box:
        """The arena along the states that it names."""
        return partial_box(self.arena, space.states)

    def sentence(self, space: Space) -> str:
        """'reach ... and avoid ...'."""
        target = ", ".join(space.interval(name, ends) for name, ends in self.target.items())
        count = len(self.obstacles)
        text = f"reach {target}{self.then} and avoid {count} obstacle{'' if count == 1 else 's'}"
        if self.clearance:
            distances = [f"{space.quantity(name, value)} in {name}" for name, value in self.clearance.items()]
            text += ", clear of them and of the walls by " + ", ".join(distances)
        return text

    def plane(self, space: Space) -> Plane | None:
        """Arena, obstacles and target on the floor of a body that drives."""
        if space.pose is None:
            return None
        arena, shown = self.region(space), space.pose[:2]
        return Plane(
            axes=space.pose,
            arena=projected(arena, arena, shown),
            target=projected(self.goal_box(space), arena, shown),
            obstacles=tuple(projected(box, arena, shown) for box in self.boxes(space)),
            radius=max(self.clearance.values(), default=RADIUS),
        )

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """Target, obstacles and the border of the arena."""
        arena, (face, edge) = self.region(space), look.target
        rectangle(
            axes, projected(self.goal_box(space), arena, shown), facecolor=face, edgecolor=edge, lw=1.0, label="target"
        )
        for box in self.boxes(space):
            if any(np.isfinite([box.lo[j], box.hi[j]]).any() for j in shown):
                rectangle(axes, projected(box, arena, shown), facecolor=look.obstacle, lw=0, label="obstacle")
        rectangle(
            axes,
            projected(arena, arena, shown),
            facecolor="none",
            edgecolor=look.border,
            lw=2.0,
            zorder=3,
            label="arena",
        )


def _slab(j: int, lo: Floats, hi: Floats) -> Box:
    """The interval of one state, other states free."""
    low, high = np.full(lo.size, -np.inf), np.full(lo.size, np.inf)
    low[j], high[j] = lo[j], hi[j]
    return Box(low, high)
