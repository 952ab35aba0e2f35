"""Boxes of states as sets of cells, and boxes that name only some states.

A cell lies in a box when it is contained in it, and meets a box when their interiors overlap; both are decided for the
cell shrunk by 1e-9 of its width on each side, so that faces which coincide up to rounding count as coinciding. Along a
periodic axis a box stands for all its copies, whole periods apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.config.base import Interval
from simgap.errors import UserError
from simgap.geometry import Box, Grid

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
    parts = np.stack(np.meshgrid(*cuts, indexing="ij"), axis=-1).reshape(-1, box.size)
    return bool(np.any([other.contains(parts) for other in by], axis=0).all())


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
