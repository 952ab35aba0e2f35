"""How near states are to losing: what a greedy adversary steers towards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.geometry import Grid
from simgap.specifications.solution import Solution

NOWHERE = 1e9  # outside the grid: nothing is nearer to losing


@dataclass(frozen=True, eq=False)
class Danger:
    """Two measures over the cells, larger where it is worse.

    Attributes:
        grid: the cells. edge: (cells,) minus the distance to the nearest losing cell, in cells; the seam of a periodic
            axis is taken for an end, which makes this a guide and no bound.
        level: (cells,) worst-case steps to the target, None where nothing is to be reached.
    """

    grid: Grid
    edge: NDArray[np.float32]
    level: NDArray[np.float32] | None

    @staticmethod
    def of(solution: Solution) -> Danger:
        """From a winning domain."""
        from scipy.ndimage import distance_transform_edt

        grid = solution.grid
        inside = np.pad(
            solution.winning.reshape(grid.cells), [(int(j not in grid.periodic),) * 2 for j in range(len(grid.cells))]
        )
        trimmed = tuple(slice(None) if j in grid.periodic else slice(1, -1) for j in range(len(grid.cells)))
        edge = -np.asarray(distance_transform_edt(inside), np.float32)[trimmed].reshape(-1)
        if solution.value is None:
            return Danger(grid, edge, None)
        level = solution.value.reshape(grid.size, -1).max(axis=1).astype(np.float32)
        return Danger(grid, edge, np.where(level < 0, np.float32(NOWHERE), level))

    def __call__(self, x: Floats, by_level: bool = False) -> Floats:
        """Of states (..., nx): -> (...)."""
        cells = self.grid.index(x.reshape(-1, x.shape[-1]))
        field = self.level if by_level and self.level is not None else self.edge
        return np.where(cells >= 0, field[cells], NOWHERE).reshape(x.shape[:-1]).astype(np.float64)
