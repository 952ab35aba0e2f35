"""Differences between the samples of neighbouring cells, on arrays (cells_1, ..., cells_nx, M)."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Bools, Floats
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
        ahead, behind = step, np.roll(step, 1, axis=j)
    else:
        first, last = np.take(step, [0], axis=j), np.take(step, [-1], axis=j)
        ahead, behind = np.concatenate([step, last], axis=j), np.concatenate([first, step], axis=j)
    if expected is None:
        return np.maximum(np.abs(ahead), np.abs(behind))
    return np.maximum(np.abs(ahead - expected), np.abs(behind - expected))


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
