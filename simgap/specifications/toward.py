"""The monitor of a run towards a target: the level of the value function, and the distance to obstacles and walls.

A body with a round footprint on a floor has a Euclidean distance there. Any other plant has states of different units:
its distance to a box is the largest over the axes, each in shares of the width of X along that axis.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.geometry import Box
from simgap.specifications.monitor import Monitor, Outcome, Run, Verdict
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space

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

    def levels(self, run: Run) -> Ints:
        """Worst-case steps to the target at each sample, from what was measured and remembered: (k + 1,), -1 where
        losing."""
        return self.solution.levels(run.measured, run.memory)

    def arrived(self, measured: Floats) -> bool:
        """True if what is measured (nx,) is the end of a run, whatever is pending."""
        cell = self._find(measured)
        return cell >= 0 and self._ended[cell]

    def in_target(self, x: Floats) -> Bools:
        """True where states are in the target's box: (n, nx) -> (n,); along periodic states in any of its copies."""
        inside = np.ones(len(x), np.bool_)
        for j in range(self.space.size):
            lo, hi = self.target.lo[j], self.target.hi[j]
            if j in self.space.periodic and np.isfinite(lo):
                period = self.space.box.hi[j] - self.space.box.lo[j]
                inside &= np.mod(x[:, j] - lo, period) <= hi - lo
            else:
                inside &= (x[:, j] >= lo) & (x[:, j] <= hi)
        return inside

    def judge(self, run: Run, steps: int) -> Verdict:
        """Cut the run where it touches something, or ask how it ended."""
        if run.clearance is None:  # no path between samples was recorded
            near = self.surroundings.along_chords(run.x)
            run = replace(run, clearance=near)
        assert run.clearance is not None
        hit = first_touch(run.clearance) if len(run.inputs) else None
        run = run if hit is None else run.until(hit)
        levels = self.levels(run)
        end, kept = (self.surroundings.touched, False) if hit is not None else self.ended(run, levels, steps)
        safe = (np.arange(len(run.x)) < len(run.x) - (hit is not None)) & self.unbroken(run, levels)
        figures = self.measured(run, levels, hit is not None)
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

    @cached_property
    def _find(self) -> Any:
        return self.solution.grid.finder()

    @cached_property
    def _ended(self) -> list[bool]:
        return self.solution.ended.tolist()  # a list answers faster than an array, one element at a time
