"""Values on a grid, some layers of cells at a time, with the layers beside them: what stencils need, and no more.

A stencil on a slab is wrong in the layers at its ends, as many as it reaches; these belong to the slabs beside it, and
`Slab.own` leaves them out. At an end of the grid there are none, and a stencil does what it does there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.gap.sampling.values import Values
from simgap.geometry import Grid

Number = TypeVar("Number", bound=np.generic)
PIECE = 2**20
"""Samples that are looked at together, where a few layers have no more."""
_READ = 4
"""Times as many that are read together where they have more: then some inputs are looked at after the others."""


@dataclass(frozen=True, eq=False)
class Slab:
    """Layers of cells along one axis, and those beside them.

    Attributes:
        grid: of what is read, for stencils: a part of the grid does not repeat itself along the axis.
        ranges: rows that are read, first and last. axis: the slowest with more than one cell.
        inner: its own layers among those that are read. first: its first own row. inputs: to look at together.
    """

    grid: Grid
    ranges: tuple[tuple[int, int], ...]
    axis: int
    inner: slice
    first: int
    inputs: tuple[slice, ...]

    def read(self, values: Values) -> Floats:
        """Values (N, M) on the slab: (cells_1, ..., cells_nx, M)."""
        parts = [values.rows(*ends) for ends in self.ranges]
        rows = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return rows.reshape(*self.grid.cells, -1)

    def own(self, cells: NDArray[Number]) -> NDArray[Number]:
        """What belongs to the slab's own cells."""
        return cells[(slice(None),) * self.axis + (self.inner,)]


def slabs(grid: Grid, inputs: int, reach: int) -> Iterator[Slab]:
    """Slabs for stencils that reach so many cells, in order; together all samples, each in one slab of its own."""
    axis = next((j for j, count in enumerate(grid.cells) if count > 1), 0)
    count, rows = grid.cells[axis], prod(grid.cells[axis + 1 :])
    together = PIECE // (rows * inputs) - 2 * reach
    if together < 2 * reach:
        together = max(1, _READ * PIECE // (rows * inputs) - 2 * reach)
    for a in range(0, count, together):
        b = min(a + together, count)
        if (a, b) == (0, count):
            ranges, inner, periodic = [(0, count)], slice(0, count), grid.periodic
        elif axis in grid.periodic:
            ranges, inner = _wrapped(a - reach, b + reach, count), slice(reach, reach + b - a)
            periodic = tuple(j for j in grid.periodic if j != axis)
        else:
            low = max(0, a - reach)
            ranges, inner, periodic = [(low, min(count, b + reach))], slice(a - low, b - low), grid.periodic
        layers = sum(last - first for first, last in ranges)
        cells = [layers if j == axis else own for j, own in enumerate(grid.cells)]
        ends = tuple((first * rows, last * rows) for first, last in ranges)
        yield Slab(Grid(grid.box, cells, periodic), ends, axis, inner, a * rows, tuple(_some(inputs, layers * rows)))


def _wrapped(first: int, last: int, count: int) -> list[tuple[int, int]]:
    """Layers first to last - 1 of a periodic axis, as ranges."""
    found = []
    while first < last:
        start = first % count
        stop = min(count, start + last - first)
        found.append((start, stop))
        first += stop - start
    return found


def _some(inputs: int, rows: int) -> Iterator[slice]:
    step = max(1, PIECE // rows)
    for first in range(0, inputs, step):
        yield slice(first, min(first + step, inputs))
