"""Cells around differences that the grid does not resolve: a jump, or a bend that is too sharp for it.

Steep differences are taken out, steepest first, until the ratio of the rest, over one cell and over two, is within
`GATE`; the cells on both sides of those and their neighbours are rough. Then the same over two cells, for jumps on a
sample: they are split in two and no steeper over one cell than over two. What is out is what exceeds a number, so that
two numbers an axis are all that there is to remember, and cells are marked where they are looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.gap.lipschitz.slabs import slabs
from simgap.gap.lipschitz.stencils import contain, double_steps, middle, modes, steps, to_cells, window
from simgap.gap.sampling.values import Values
from simgap.gap.thresholds import GATE, SPLIT_GATE, STEEP_SHARE
from simgap.geometry import Grid
from simgap.late import scipy

REACH = 2
"""Cells by which a mark may be away from the difference that makes it."""


@dataclass(frozen=True)
class Roughness:
    """Above which differences cells are rough: for each axis over one cell, and over two cells without one of those."""

    axes: tuple[int, ...]
    one: Mapping[int, float]
    two: Mapping[int, float]

    @property
    def any(self) -> bool:
        """Whether any cell is rough."""
        return bool(np.isfinite([*self.one.values(), *self.two.values()]).any())

    def marks(self, e: Floats, grid: Grid) -> Bools:
        """Rough cells of values (cells_1, ..., cells_nx, M), the same shape; wrong within `REACH` of a slab's ends."""
        rough = np.zeros(e.shape, dtype=bool)
        for j in self.axes:
            two = self.two.get(j, np.inf)
            if not np.isfinite(min(self.one[j], two)):
                continue
            out = np.abs(steps(e, j, grid)) > self.one[j]
            rough |= to_cells(out, j, grid) > 0
            if np.isfinite(two):
                far = np.abs(double_steps(e, j, grid)) > two
                rough |= middle(far & ~contain(out, j, grid, 1), j, grid)
        if rough.any():
            rough = (
                scipy.ndimage.maximum_filter(rough.view(np.uint8), size=window(grid, self.axes), mode=modes(grid)) > 0
            )
        return rough


def roughness(d: Values, grid: Grid, axes: tuple[int, ...], floor: float, split: bool = True) -> Roughness:
    """What is rough in values (N, M) on a grid; differences up to `floor` never are. `split`: also over two cells."""
    one = _gates(d, grid, axes, floor, GATE, None)
    longer = [j for j in axes if split and grid.cells[j] > 4]
    return Roughness(axes, one, _gates(d, grid, longer, floor, SPLIT_GATE, one))


def _gates(
    d: Values, grid: Grid, axes: Sequence[int], floor: float, gate: float, known: Mapping[int, float] | None
) -> dict[int, float]:
    """For each axis the number above which differences are out: over one cell, or, with `known` ones, over two.

    Without them the largest difference over as many cells is within `gate` of that over twice as many.
    """
    found, left, cells = dict.fromkeys(axes, np.inf), list(axes), 1 if known is None else 2
    while left:
        fine, broad = dict.fromkeys(left, 0.0), dict.fromkeys(left, 0.0)
        for slab in slabs(grid, d.shape[1], 2 * cells):
            e = slab.read(d)
            for j, some in ((j, some) for some in slab.inputs for j in left):
                own = _rest(e[..., some], j, slab.grid, cells, found[j], np.inf if known is None else known[j])
                fine[j], broad[j] = max(fine[j], own[0]), max(broad[j], 0.5 * own[1])
        left = [j for j in left if fine[j] > max(gate * broad[j], floor)]
        for j in left:
            found[j] = min(found[j], max(gate * broad[j], STEEP_SHARE * fine[j], floor))
    return found


def _rest(e: Floats, j: int, grid: Grid, cells: int, above: float, known: float) -> tuple[float, float]:
    """Largest differences over `cells` cells and over twice as many, without those that are out."""
    step, wide = (np.abs(double_steps(e, j, grid, n)) for n in (cells, 2 * cells))
    if np.isfinite(min(above, known)):
        out = step > above
        if np.isfinite(known):
            out |= contain(np.abs(steps(e, j, grid)) > known, j, grid, 1)
        step, wide = step[~out], wide[~contain(out, j, grid, cells)]
    return float(step.max(initial=0.0)), float(wide.max(initial=0.0))
