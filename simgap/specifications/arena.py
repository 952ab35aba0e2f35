"""Arenas with obstacles: what every path keeps away from, between samples too.

A body with a round footprint on a floor has a Euclidean distance there. Any other plant has states of different units:
its distance to a box is the largest over the axes, each in shares of the width of X along that axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simgap.arrays import Bools, Floats
from simgap.config.base import Interval, NotNegative
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.specifications.base import Look, Plane, Run, Specification, projected, rectangle
from simgap.specifications.space import (
    KEY,
    Space,
    cells_meeting,
    cells_within,
    grown,
    inner_box,
    known,
    partial_box,
    unbounded,
)

POINTS = 21
"""Points on the chord of a step for which no path was recorded."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Boxes to keep away from, and the box never to leave.

    Attributes:
        obstacles: (b, 2, n) lower and upper ends along the n axes that matter, infinite where there are none.
        walls: (2, n) likewise.
        axes: the states along these axes; scale: (n,) what a distance along each is divided by.
        keep: (n,) distance to keep along each axis, already divided.
        period: (n,) of the axes that wrap around, infinite for others.
        round: whether the footprint is round, and `keep` (n equal numbers) its radius.
    """

    obstacles: Floats
    walls: Floats
    axes: tuple[int, ...]
    scale: Floats
    keep: Floats
    period: Floats
    round: bool

    @property
    def touched(self) -> str:
        """End of a run that touches something."""
        return "collision" if self.round else "left the free set"

    @staticmethod
    def of(space: Space, obstacles: tuple[Box, ...], region: Box, clearance: Floats) -> Surroundings:
        """From boxes over all states and the clearance (nx,) of the case."""
        wraps = space.wrapping(region)
        floor = space.pose is not None and on_floor(obstacles, clearance, space.pose)
        axes = list(space.pose[:2] if space.pose is not None and floor else range(space.size))
        walls = np.stack([region.lo, region.hi])
        walls[:, list(wraps)] = [[-np.inf], [np.inf]]
        width = space.box.hi - space.box.lo
        scale = np.ones(len(axes)) if floor else width[axes]
        keep = np.full(len(axes), clearance[axes].min()) if floor else clearance[axes] / scale
        return Surroundings(
            obstacles=np.array([[b.lo[axes], b.hi[axes]] for b in obstacles]).reshape(-1, 2, len(axes)),
            walls=walls[:, axes],
            axes=tuple(axes),
            scale=scale,
            keep=keep,
            period=np.array([width[j] if j in wraps else np.inf for j in axes]),
            round=floor,
        )

    def least(self, path: Floats) -> float:
        """Least distance along points (k, nx), less what is to be kept; not positive where something is touched."""
        return float(self.distances(path).min())

    def distances(self, points: Floats) -> Floats:
        """Distance of each point, less what is to be kept: (..., nx) -> (...)."""
        at = points[..., list(self.axes)]
        inside = np.minimum(at - self.walls[0], self.walls[1] - at) / self.scale
        nearest = (inside - self.keep).min(axis=-1)
        for box in self.obstacles:
            nearest = np.minimum(nearest, self._to_box(at, box))
        return nearest

    def along_chords(self, x: Floats) -> Floats:
        """Least distance at the first sample and along the straight line of each step: (k + 1, nx) -> (k + 1,)."""
        share = np.linspace(0.0, 1.0, POINTS)[:, None, None]
        chords = x[:-1] + share * (x[1:] - x[:-1])
        return np.concatenate([self.distances(x[:1]), self.distances(chords).min(axis=0)])

    def _to_box(self, at: Floats, box: Floats) -> Floats:
        outside = np.maximum(box[0] - at, at - box[1])
        for j in np.flatnonzero(np.isfinite(self.period)).tolist():
            shifts = self._copies(at, box, j)
            copies = [np.maximum(box[0, j] + s - at[..., j], at[..., j] - box[1, j] - s) for s in shifts]
            outside[..., j] = np.min(copies, axis=0)
        outside = outside / self.scale
        if not self.round:
            return np.asarray((outside - self.keep).max(axis=-1))
        far = np.hypot(np.maximum(outside[..., 0], 0.0), np.maximum(outside[..., 1], 0.0))
        return np.asarray(far + np.minimum(outside.max(axis=-1), 0.0) - self.keep[0])

    def _copies(self, at: Floats, box: Floats, j: int) -> Floats:
        """Shifts of the copies of a box that may be near points anywhere on a periodic axis."""
        centre = 0.5 * (box[0, j] + box[1, j]) if np.isfinite(box[:, j]).all() else 0.0
        middle = np.round((at[..., j] - centre) / self.period[j]) * self.period[j]
        return np.stack([middle + n * self.period[j] for n in (-1.0, 0.0, 1.0)])


def on_floor(obstacles: tuple[Box, ...], clearance: Floats, pose: tuple[int, int, int]) -> bool:
    """True if obstacles and clearance are about x and y alone, so that the footprint is round."""
    others = np.ones(clearance.size, np.bool_)
    others[list(pose[:2])] = False
    bounded = [np.isfinite(box.lo[others]) | np.isfinite(box.hi[others]) for box in obstacles]
    return not np.any(clearance[others]) and not any(np.any(b) for b in bounded)


def first_touch(clearance: Floats) -> int | None:
    """First step in which clearances (k + 1,) touch, counted from 1; a start that touches ends in its first step."""
    touched: NDArray[np.intp] = np.flatnonzero(clearance <= 0.0)
    return None if len(touched) == 0 else max(int(touched[0]), 1)


def until_touch(run: Run, surroundings: Surroundings) -> tuple[Run, bool]:
    """The run up to its first touch, with its clearance, and whether there is one."""
    if run.clearance is None:  # no path between samples was recorded
        run = replace(run, clearance=surroundings.along_chords(run.x))
    assert run.clearance is not None
    hit = first_touch(run.clearance) if len(run.inputs) else None
    return (run, False) if hit is None else (run.until(hit), True)


RADIUS = 0.15
"""Radius of a footprint to draw where a case gives no clearance."""


class Arena(Specification):
    """Move in an arena without touching obstacles, between samples too."""

    arena: dict[str, Interval] = Field(default_factory=dict)
    """For each state the interval never to leave; states not named keep all of X."""
    obstacles: tuple[dict[str, Interval], ...] = ()
    """Boxes to avoid; an obstacle holds for all values of the states it does not name."""
    clearance: dict[str, NotNegative] = Field(default_factory=dict)
    """For a state, how far to keep from walls and obstacles (half the footprint), in its unit."""

    between_samples: ClassVar[bool] = True

    def region(self, space: Space) -> Box:
        """The arena; obstacles must lie in it."""
        arena = inner_box(self.arena, space.states, space.box, "arena")
        for number, named in enumerate(self.obstacles):
            known(named, space.states, f"obstacles[{number}]")
        known(self.clearance, space.states, "clearance")
        within = unbounded(arena, space.wrapping(arena))
        for number, box in enumerate(self.boxes(space)):
            if not np.all((box.lo < within.hi) & (box.hi > within.lo)):
                raise UserError("the obstacle lies outside the arena", key=f"{KEY}.obstacles[{number}]")
        return arena

    def on_floor(self, space: Space) -> bool:
        """True if obstacles and clearance are about x and y alone: swept boxes do not say which headings a path has."""
        return space.pose is not None and on_floor(self.boxes(space), space.vector(self.clearance), space.pose)

    def boxes(self, space: Space) -> tuple[Box, ...]:
        """The obstacles, infinite along the states that they do not name."""
        return tuple(partial_box(named, space.states) for named in self.obstacles)

    def surroundings(self, space: Space) -> Surroundings:
        """Obstacles and walls with the clearance that runs keep from them."""
        return Surroundings.of(space, self.boxes(space), self.region(space), space.vector(self.clearance))

    def free(self, space: Space, grid: Grid, margin: Floats) -> Bools:
        """Cells that keep the clearance and a margin from every obstacle and, along axes that end, the walls.

        The margin is (nx,), or (2, nx): from obstacles, and from walls.
        """
        keep, walls = np.broadcast_to(space.vector(self.clearance) + margin, (2, space.size))
        lo, hi = grid.box.lo + walls, grid.box.hi - walls
        lo[list(grid.periodic)], hi[list(grid.periodic)] = -np.inf, np.inf
        if np.any(lo >= hi):
            raise UserError("the clearance leaves no room in the arena", key=f"{KEY}.clearance")
        free = cells_within(grid, Box(lo, hi))
        for box in self.boxes(space):
            free &= ~cells_meeting(grid, grown(box, keep))
        return free

    def limits(self, space: Space) -> Box:
        """The arena along the states that it names."""
        return partial_box(self.arena, space.states)

    def avoiding(self) -> str:
        """' and avoid 2 obstacles', empty where there are none."""
        count = len(self.obstacles)
        return f" and avoid {count} obstacle{'' if count == 1 else 's'}" if count else ""

    def clear_of(self, space: Space) -> str:
        """', clear of ... walls by ...', empty without a clearance."""
        distances = [f"{space.quantity(name, value)} in {name}" for name, value in self.clearance.items()]
        what = "them and of the walls" if self.obstacles else "the walls"
        return f", clear of {what} by " + ", ".join(distances) if distances else ""

    def plane(self, space: Space) -> Plane | None:
        """Arena and obstacles on the floor of a body that drives."""
        if space.pose is None:
            return None
        arena, shown = self.region(space), space.pose[:2]
        return Plane(
            axes=space.pose,
            arena=projected(arena, arena, shown),
            target=None,
            obstacles=tuple(projected(box, arena, shown) for box in self.boxes(space)),
            radius=max(self.clearance.values(), default=RADIUS),
        )

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """Obstacles and the border of the arena."""
        arena = self.region(space)
        for box in self.boxes(space):
            if any(np.isfinite([box.lo[j], box.hi[j]]).any() for j in shown):
                rectangle(axes, projected(box, arena, shown), facecolor=look.obstacle, lw=0, label="obstacle")
        border = projected(arena, arena, shown)
        rectangle(axes, border, facecolor="none", edgecolor=look.border, lw=2.0, zorder=3, label="arena")
