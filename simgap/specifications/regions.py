"""Boxes of states as sets of cells.

A cell lies in a box when it is contained in it, and meets a box when their interiors overlap; both are decided for the
cell shrunk by 1e-9 of its width on each side, so that faces which coincide up to rounding count as coinciding.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from simgap.geometry import Box, Grid

Mask = NDArray[np.bool_]
SHRINK = 1e-9


def partial_box(named: dict[str, tuple[float, float]], states: tuple[str, ...]) -> Box:
    """A box that bounds only the named states; the others are free."""
    ends = [named.get(name, (-np.inf, np.inf)) for name in states]
    return Box([lo for lo, _ in ends], [hi for _, hi in ends])


def grown(box: Box, by: NDArray[np.float64]) -> Box:
    """The box with every face moved outward by `by` (nx,); a negative number moves it inward."""
    return Box(box.lo - by, box.hi + by)


def cells_within(grid: Grid, box: Box) -> Mask:
    """Cells contained in the box: (cells,)."""
    lower, upper = _faces(grid)
    return _all_axes([(a >= box.lo[j]) & (b <= box.hi[j]) for j, (a, b) in enumerate(zip(lower, upper, strict=True))])


def cells_meeting(grid: Grid, box: Box) -> Mask:
    """Cells whose interior overlaps the box: (cells,)."""
    lower, upper = _faces(grid)
    return _all_axes([(b > box.lo[j]) & (a < box.hi[j]) for j, (a, b) in enumerate(zip(lower, upper, strict=True))])


def _faces(grid: Grid) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    width = 2.0 * grid.h
    edges = [grid.box.lo[j] + width[j] * np.arange(c + 1) for j, c in enumerate(grid.cells)]
    shrink = SHRINK * width
    lower = [e[:-1] + s for e, s in zip(edges, shrink, strict=True)]
    return lower, [e[1:] - s for e, s in zip(edges, shrink, strict=True)]


def _all_axes(flags: list[Mask]) -> Mask:
    return reduce(np.logical_and.outer, flags).reshape(-1)
