"""Distance of states from losing: what a greedy adversary steers towards, and the starts that are won most narrowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.geometry import Grid, drawn_in_cells
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
        """Danger of states (..., nx): -> (...)."""
        cells = self.grid.index(x.reshape(-1, x.shape[-1]))
        field = self.level if by_level and self.level is not None else self.edge
        return np.where(cells >= 0, field[cells], NOWHERE).reshape(x.shape[:-1]).astype(np.float64)


NARROWEST = 0.02  # share of the cells, or all of the same number, from which narrow ones are drawn


class WorstStarts:
    """Cells in which a run does not end at once, by what makes them narrow; the `danger` is of the solution's cells.

    A quarter of the starts each come from cells of the smallest `margin` (cells,) if it is known, from those at the
    edge of the winning domain, from those of the greatest level, and from all of them.
    """

    def __init__(self, solution: Solution, margin: NDArray[np.float32] | None = None) -> None:
        danger, cells = Danger.of(solution), solution.beginnings
        fields = [danger.edge[cells]]
        fields += [np.nan_to_num(-margin[cells], nan=-np.inf)] if margin is not None else []
        fields += [danger.level[cells]] if danger.level is not None else []
        self.danger = danger
        self._pools = [cells, *(_cells_with_largest(cells, field) for field in fields)]

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """States (count, nx): half of them at corners of their cells, a quarter on a face, a quarter inside."""
        turns = rng.integers(0, len(self._pools), count)
        chosen = np.array([rng.choice(self._pools[k]) for k in turns], dtype=np.int64)
        return drawn_in_cells(self.danger.grid, chosen, rng, (0, 1))


def _cells_with_largest(cells: Ints, field: NDArray[np.float32]) -> Ints:
    """Cells whose number is among the largest."""
    limit = np.quantile(field, 1.0 - NARROWEST, method="lower")
    return cells[field >= limit]
