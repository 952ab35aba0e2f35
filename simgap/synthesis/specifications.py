"""What a controller can be asked for: one class per kind, listed in `SPECIFICATIONS`.

A new kind is a subclass of `Specification` with a line in that dictionary and a section in `config.synthesis`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.specifications.regions import cells_meeting, cells_within, grown, partial_box
from simgap.specifications.solution import Solution
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.invariance import invariance
from simgap.synthesis.reach import reach_avoid

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
KEY = "synthesis.specification"


@dataclass(frozen=True, eq=False)
class Specification(ABC):
    """A specification on named states.

    Attributes:
        states: names of the states, in order.
        region: the box that the cells tile; the closed loop never leaves it.
    """

    states: tuple[str, ...]
    region: Box

    @staticmethod
    @abstractmethod
    def of(options: Mapping[str, Any], states: tuple[str, ...], domain: Box) -> Specification:
        """From the keys of the case.

        Raises:
            UserError: when it does not fit into the state box X (`domain`).
        """

    @abstractmethod
    def solve(self, abstraction: Abstraction, threads: int = 1) -> Solution:
        """The winning domain and all admissible inputs.

        Raises:
            UserError: when the grid cannot express the specification.
        """

    def with_clearance(self, extra: Floats) -> Specification:
        """Keep `extra` (nx,) farther from walls and obstacles, for what happens between samples."""
        return self


@dataclass(frozen=True, eq=False)
class InvarianceSpecification(Specification):
    """Stay in `region` for ever, at sampling instants."""

    @staticmethod
    def of(options: Mapping[str, Any], states: tuple[str, ...], domain: Box) -> InvarianceSpecification:
        """`options`: `safe`."""
        return InvarianceSpecification(states, _inner_box(options["safe"], states, domain, "safe"))

    def solve(self, abstraction: Abstraction, threads: int = 1) -> Solution:
        """The maximal controlled invariant set in the region."""
        found = invariance(abstraction, threads=threads)
        return Solution(
            grid=abstraction.grid,
            winning=found.winning,
            mask=found.mask,
            free=np.ones(abstraction.grid.size, np.bool_),
            statistics={"sweeps": found.sweeps, "pairs": found.pairs},
        )


@dataclass(frozen=True, eq=False)
class ReachAvoidSpecification(Specification):
    """Reach `target` inside `region` without entering `obstacles` on the way.

    Attributes:
        obstacles: boxes, infinite along the states that do not matter.
        target: a box, likewise.
        clearance: distance kept from obstacles and from the faces of the region, (nx,).
    """

    obstacles: tuple[Box, ...]
    target: Box
    clearance: Floats

    @staticmethod
    def of(options: Mapping[str, Any], states: tuple[str, ...], domain: Box) -> ReachAvoidSpecification:
        """`options`: `arena`, `obstacles`, `target`, `clearance`."""
        arena = _inner_box(options["arena"], states, domain, "arena")
        for number, named in enumerate(options["obstacles"]):
            _known(named, states, f"obstacles[{number}]")
        _known(options["target"], states, "target")
        _known(options["clearance"], states, "clearance")
        obstacles = tuple(partial_box(named, states) for named in options["obstacles"])
        for number, box in enumerate(obstacles):
            if not np.all((box.lo < arena.hi) & (box.hi > arena.lo)):
                raise UserError("the obstacle lies outside the arena", key=f"{KEY}.obstacles[{number}]")
        target = partial_box(options["target"], states)
        bounded = np.isfinite(target.lo)
        if np.any(bounded & ((target.lo < arena.lo) | (target.hi > arena.hi))):
            raise UserError("the target lies outside the arena", key=f"{KEY}.target", remedy="Move it inside")
        clearance = np.array([float(options["clearance"].get(name, 0.0)) for name in states])
        return ReachAvoidSpecification(states, arena, obstacles, target, clearance)

    def with_clearance(self, extra: Floats) -> ReachAvoidSpecification:
        """Add to the clearance."""
        return replace(self, clearance=self.clearance + extra)

    def free(self, grid: Grid) -> Mask:
        """Cells that keep the clearance from every obstacle and, along axes that end, from the faces of the region."""
        walls = self.clearance.copy()
        lo, hi = self.region.lo + walls, self.region.hi - walls
        lo[list(grid.periodic)], hi[list(grid.periodic)] = -np.inf, np.inf
        if np.any(lo >= hi):
            raise UserError("the clearance leaves nothing of the arena", key=f"{KEY}.clearance")
        free = cells_within(grid, Box(lo, hi))
        for box in self.obstacles:
            free &= ~cells_meeting(grid, grown(box, walls))
        return free

    def goal(self, grid: Grid, error: Floats) -> Mask:
        """Cells whose every state, measured with the given error, is in the target.

        Raises:
            UserError: when no cell fits into the target.
        """
        inner_lo, inner_hi = self.target.lo + error, self.target.hi - error
        width = 2.0 * grid.h
        for j, name in enumerate(self.states):
            room = inner_hi[j] - inner_lo[j]
            if np.isfinite(room) and not cells_within(grid, self._slab(j, inner_lo[j], inner_hi[j])).any():
                raise UserError(
                    f"no cell fits into the target along {name}: it leaves {room:.6g}, a cell is {width[j]:.6g} wide",
                    key=f"{KEY}.target",
                    remedy=f"Cells of {room / 2:.6g} or less would do (`synthesis.cells`), or a larger target"
                    if room > 0
                    else "The measurement error is as large as the target: make the target larger",
                )
        return cells_within(grid, Box(inner_lo, inner_hi))

    def _slab(self, j: int, lo: float, hi: float) -> Box:
        low, high = np.full(len(self.states), -np.inf), np.full(len(self.states), np.inf)
        low[j], high[j] = min(lo, hi - 1e-300), max(hi, np.nextafter(lo, np.inf))
        return Box(low, high)

    def solve(self, abstraction: Abstraction, threads: int = 1) -> Solution:
        """The least fixed point, its value function and all inputs that go down a level."""
        free = self.free(abstraction.grid)
        target = self.goal(abstraction.grid, abstraction.error)
        if not (target & free).any():
            raise UserError(
                "every cell of the target is inside an obstacle or too near to one or to a wall",
                key=f"{KEY}.target",
                remedy="Move the target, or lower the clearance",
            )
        found = reach_avoid(abstraction, target, free, threads)
        return Solution(
            grid=abstraction.grid,
            winning=found.winning,
            mask=found.mask,
            free=free,
            value=found.value,
            target=target & free,
            statistics={"steps": found.steps, "backend": found.backend},
        )


SPECIFICATIONS: dict[str, type[Specification]] = {
    "invariance": InvarianceSpecification,
    "reach_avoid": ReachAvoidSpecification,
}


def make_specification(options: Mapping[str, Any], states: tuple[str, ...], domain: Box) -> Specification:
    """The specification of a case, from the plain keys of its section.

    Raises:
        UserError: unknown kind or states, or a box outside X.
    """
    kind = str(options["kind"])
    if kind not in SPECIFICATIONS:
        known = ", ".join(sorted(SPECIFICATIONS))
        raise UserError(f"no specification '{kind}'", key=f"{KEY}.kind", remedy=f"Known kinds: {known}")
    return SPECIFICATIONS[kind].of(options, states, domain)


def _known(named: Mapping[str, Any], states: tuple[str, ...], key: str) -> None:
    unknown = [name for name in named if name not in states]
    if unknown:
        raise UserError(f"no state '{unknown[0]}'", key=f"{KEY}.{key}", remedy=f"The states are {', '.join(states)}")


def _inner_box(named: Mapping[str, tuple[float, float]], states: tuple[str, ...], domain: Box, key: str) -> Box:
    _known(named, states, key)
    lo, hi = domain.lo.copy(), domain.hi.copy()
    for j, name in enumerate(states):
        if name in named:
            lo[j], hi[j] = named[name]
            if lo[j] < domain.lo[j] or hi[j] > domain.hi[j]:
                raise UserError(
                    f"[{lo[j]:.6g}, {hi[j]:.6g}] of {name} sticks out of X, [{domain.lo[j]:.6g}, {domain.hi[j]:.6g}]",
                    key=f"{KEY}.{key}",
                    remedy="Shrink it, or enlarge domain.X",
                )
    return Box(lo, hi)
