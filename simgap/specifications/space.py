"""The states of a case as a specification sees them, and boxes of states, partial ones too, as sets of cells.

A cell lies in a box when it is contained in it, and meets a box when their interiors overlap; both are decided for the
cell shrunk by 1e-9 of its width on each side, so that faces which coincide up to rounding count as coinciding. Along a
periodic axis a box stands for all its copies, whole periods apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.config.base import Interval
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.geometry import Box, Grid, mesh
from simgap.notation import pretty_unit


@dataclass(frozen=True, eq=False)
class Space:
    """States in order.

    Attributes:
        states: names, nx of them; units: by name, none where they do not matter.
        box: the state box X.
        periodic: axes that wrap around at the ends of X.
        pose: axes of x, y and heading of a body with a round footprint that drives on a floor; None for other plants.
        tau: sampling time, s.
    """

    states: tuple[str, ...]
    box: Box
    periodic: tuple[int, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    pose: tuple[int, int, int] | None = None
    tau: float = 1.0

    @staticmethod
    def of(case: Case) -> Space:
        """The states of a case.

        Raises:
            UserError: a case without a domain.
        """
        if case.domain is None:
            raise UserError("a specification needs the section", key="domain", remedy="Add `domain:`.")
        states = tuple(case.plant.states)
        ends = [case.domain.X[name] for name in states]
        wheels = case.plant.symbolic.wheels if case.plant.symbolic is not None else None
        pose = (states.index(wheels.x), states.index(wheels.y), states.index(wheels.heading)) if wheels else None
        return Space(
            states=states,
            box=Box([lo for lo, _ in ends], [hi for _, hi in ends]),
            periodic=tuple(states.index(name) for name in case.domain.periodic),
            units={name: state.unit for name, state in case.plant.states.items()},
            pose=pose,
            tau=case.domain.tau,
        )

    @property
    def size(self) -> int:
        """Number of states nx."""
        return len(self.states)

    def wrapping(self, region: Box) -> tuple[int, ...]:
        """Periodic axes along which a region takes the whole period; along others it ends like any interval."""
        return tuple(j for j in self.periodic if region.lo[j] == self.box.lo[j] and region.hi[j] == self.box.hi[j])

    def grid(self, region: Box, cells: Sequence[int]) -> Grid:
        """Cells that tile a region."""
        return Grid(region, cells, self.wrapping(region))

    def wrapped(self, x: Floats) -> Floats:
        """Periodic states brought into X: (..., nx) -> (..., nx)."""
        return x - self._turns(x) if self.periodic else x

    def unwound(self, x: Floats, following: Floats) -> tuple[Floats, Floats]:
        """States with the periodic ones brought into X, successors moved by the same whole turns: (k, nx) twice."""
        if not self.periodic:
            return x, following
        turns = self._turns(x)
        return x - turns, following - turns

    def _turns(self, x: Floats) -> Floats:
        turns = np.zeros_like(x)
        for j in self.periodic:
            period = self.box.hi[j] - self.box.lo[j]
            turns[..., j] = np.floor((x[..., j] - self.box.lo[j]) / period) * period
        return turns

    def vector(self, named: Mapping[str, float]) -> Floats:
        """Numbers by state as an array (nx,), 0 for states that are not named."""
        return np.array([float(named.get(name, 0.0)) for name in self.states])

    def quantity(self, name: str, value: float) -> str:
        """A number with the unit of a state."""
        return f"{value:g} {pretty_unit(self.units.get(name, ''))}".strip()

    def interval(self, name: str, ends: tuple[float, float]) -> str:
        """'x in [0, 1] m'."""
        return f"{name} in [{ends[0]:g}, {ends[1]:g}] {pretty_unit(self.units.get(name, ''))}".strip()


SHRINK = 1e-9
MOST_PARTS = 100_000
KEY = "synthesis.specification"


def known(named: Mapping[str, object], states: tuple[str, ...], key: str) -> None:
    """Refuse names that are no states.

    Raises:
        UserError: with the names that there are.
    """
    unknown = [name for name in named if name not in states]
    if unknown:
        raise UserError(f"no state '{unknown[0]}'", key=f"{KEY}.{key}", remedy=f"The states are {', '.join(states)}")


def inner_box(named: Mapping[str, Interval], states: tuple[str, ...], domain: Box, key: str) -> Box:
    """The state box X narrowed along the named states.

    Raises:
        UserError: an unknown state, or an interval that sticks out of X.
    """
    known(named, states, key)
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


def partial_box(named: Mapping[str, Interval], states: tuple[str, ...]) -> Box:
    """A box that bounds only the named states; the others are free."""
    ends = [named.get(name, (-np.inf, np.inf)) for name in states]
    return Box([lo for lo, _ in ends], [hi for _, hi in ends])


def unbounded(box: Box, axes: tuple[int, ...]) -> Box:
    """The box without ends along some axes."""
    lo, hi = box.lo.copy(), box.hi.copy()
    lo[list(axes)], hi[list(axes)] = -np.inf, np.inf
    return Box(lo, hi)


def grown(box: Box, by: Floats) -> Box:
    """The box with every face moved outward by `by` (nx,); a negative number moves it inward."""
    return Box(box.lo - by, box.hi + by)


def covered(box: Box, by: Sequence[Box]) -> bool:
    """True if boxes hold all of a bounded box together: their faces cut it into parts that lie in each or beside it.

    False, too, where there are more than `MOST_PARTS` parts: cells are asked then.
    """
    cuts = []
    for j, (lo, hi) in enumerate(zip(box.lo, box.hi, strict=True)):
        ends = [lo, hi, *(end for other in by for end in (other.lo[j], other.hi[j]) if lo < end < hi)]
        faces = np.unique(ends)
        cuts.append(0.5 * (faces[1:] + faces[:-1]))
    if not by or math.prod(map(len, cuts)) > MOST_PARTS:
        return False
    return bool(np.any([other.contains(mesh(*cuts)) for other in by], axis=0).all())


def cells_within(grid: Grid, box: Box) -> Bools:
    """Cells contained in the box: (cells,)."""
    return _along_axes(grid, box, lambda low, high, lo, hi: (low >= lo) & (high <= hi))


def cells_meeting(grid: Grid, box: Box) -> Bools:
    """Cells whose interior overlaps the box: (cells,)."""
    return _along_axes(grid, box, lambda low, high, lo, hi: (high > lo) & (low < hi))


def _nearest_copy(grid: Grid, box: Box, j: int) -> float:
    """The whole turns that bring a box on a periodic axis nearest to the grid; 0 for one without both ends."""
    ends, period = (box.lo[j], box.hi[j]), grid.box.hi[j] - grid.box.lo[j]
    if not np.isfinite(ends).all():
        return 0.0
    return float(np.round(0.5 * (grid.box.lo[j] + grid.box.hi[j] - ends[0] - ends[1]) / period) * period)


def _along_axes(grid: Grid, box: Box, test: Callable[[Floats, Floats, float, float], Bools]) -> Bools:
    """The test of every cell's faces against the box's, axis by axis, all of which must hold: (cells,)."""
    flags = []
    for j, count in enumerate(grid.cells):
        width = 2.0 * grid.h[j]
        edges = grid.box.lo[j] + width * np.arange(count + 1)
        low, high = edges[:-1] + SHRINK * width, edges[1:] - SHRINK * width
        period = grid.box.hi[j] - grid.box.lo[j]
        near = _nearest_copy(grid, box, j) if j in grid.periodic else 0.0
        copies = (near - period, near, near + period) if j in grid.periodic else (0.0,)
        flags.append(np.any([test(low, high, box.lo[j] + by, box.hi[j] + by) for by in copies], axis=0))
    return reduce(np.logical_and.outer, flags).reshape(-1)


def in_copies(space: Space, box: Box, x: Floats) -> Bools:
    """True where states are in a box, along periodic states in any of its copies: (n, nx) -> (n,)."""
    inside = np.ones(len(x), np.bool_)
    for j in range(space.size):
        lo, hi = box.lo[j], box.hi[j]
        if j in space.periodic and np.isfinite(lo):
            inside &= np.mod(x[:, j] - lo, space.box.hi[j] - space.box.lo[j]) <= hi - lo
        else:
            inside &= (x[:, j] >= lo) & (x[:, j] <= hi)
    return inside
