"""Differences between neighbouring cells on arrays (cells_1, ..., cells_nx, M), and slabs of layers to take them on.

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

from simgap.arrays import Bools, Floats
from simgap.gap.sampling.values import Values
from simgap.geometry import Grid
from simgap.late import scipy


def steps(e: Floats, j: int, grid: Grid) -> Floats:
    """Differences of neighbours along j: (..., k, ..., M) -> (..., k - 1, ..., M); k, with the seam, if periodic."""
    if j in grid.periodic:
        return np.roll(e, -1, axis=j) - e
    return np.diff(e, axis=j)


def double_steps(e: Floats, j: int, grid: Grid, cells: int = 2) -> Floats:
    """Differences over `cells` cells along axis j: (..., k, ..., M) -> (..., k - cells, ..., M), or k if periodic."""
    if j in grid.periodic:
        return np.roll(e, -cells, axis=j) - e
    n = e.shape[j]
    return np.take(e, range(cells, n), axis=j) - np.take(e, range(n - cells), axis=j)


def contain(out: Bools, j: int, grid: Grid, cells: int) -> Bools:
    """Differences over twice `cells` cells that contain one of `out`, which are over `cells` cells."""
    if j in grid.periodic:
        return np.logical_or.reduce([np.roll(out, -k, axis=j) for k in range(cells + 1)])
    n = out.shape[j] - cells
    return np.logical_or.reduce([np.take(out, range(k, n + k), axis=j) for k in range(cells + 1)])


def middle(out: Bools, j: int, grid: Grid) -> Bools:
    """The cells in the middle of differences over two cells."""
    if j in grid.periodic:
        return np.roll(out, 1, axis=j)
    edge = np.zeros_like(np.take(out, [0], axis=j))
    return np.concatenate([edge, out, edge], axis=j)


def to_cells(step: Floats | Bools, j: int, grid: Grid, expected: Floats | None = None) -> Floats:
    """Larger absolute difference beside each cell, less its `expected`: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        forward, backward = step, np.roll(step, 1, axis=j)
    else:
        first, last = np.take(step, [0], axis=j), np.take(step, [-1], axis=j)
        forward, backward = np.concatenate([step, last], axis=j), np.concatenate([first, step], axis=j)
    if expected is None:
        return np.maximum(np.abs(forward), np.abs(backward))
    return np.maximum(np.abs(forward - expected), np.abs(backward - expected))


def bends(step: Floats, j: int, grid: Grid) -> Floats:
    """Absolute second differences at each cell, at an edge its neighbour's: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        return np.abs(step - np.roll(step, 1, axis=j))
    inner = np.abs(np.diff(step, axis=j))
    return np.concatenate([np.take(inner, [0], axis=j), inner, np.take(inner, [-1], axis=j)], axis=j)


def turns(step: Floats, j: int, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Change of `steps` along j within a cell: along j, half a cell along the others; (cells_1, ..., cells_nx, M)."""
    total = bends(step, j, grid)
    for k in axes:
        if k != j:
            total += 0.5 * to_cells(to_cells(steps(step, k, grid), k, grid), j, grid)
    return total


def window(grid: Grid, axes: tuple[int, ...]) -> tuple[int, ...]:
    """Filter size that reaches the neighbours of a cell, diagonal ones included."""
    return (*(3 if j in axes else 1 for j in range(len(grid.cells))), 1)


def modes(grid: Grid) -> list[str]:
    """Filter border modes."""
    return [*("wrap" if j in grid.periodic else "nearest" for j in range(len(grid.cells))), "nearest"]


def widest(e: Floats, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Largest value around each cell, diagonal neighbours included."""
    return np.asarray(scipy.ndimage.maximum_filter(e, size=window(grid, axes), mode=modes(grid)))


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
        parts = [values[slice(*ends)] for ends in self.ranges]
        rows = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return rows.reshape(*self.grid.cells, -1)

    def own(self, cells: NDArray[Number]) -> NDArray[Number]:
        """The part that belongs to the slab's own cells."""
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
