"""Where the adversary begins: faces and corners of the cells that are won most narrowly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.attack.danger import Danger
from simgap.geometry import points_of_cells
from simgap.specifications.solution import Solution

NARROWEST = 0.02  # share of the cells, or all of the same number, from which narrow ones are drawn


class WorstStarts:
    """Winning cells in which a run does not end at once (`beginnings`), by what makes them narrow.

    A quarter of the starts each come from cells of the smallest `margin` (cells,) if it is known, from those at the
    edge of the winning domain, from those of the greatest level, and from all `cells` (k,).
    """

    def __init__(self, danger: Danger, margin: NDArray[np.float32] | None, cells: Ints) -> None:
        fields = [danger.edge[cells]]
        fields += [np.nan_to_num(-margin[cells], nan=-np.inf)] if margin is not None else []
        fields += [danger.level[cells]] if danger.level is not None else []
        self._grid = danger.grid
        self._pools = [cells, *(_largest(cells, field) for field in fields)]

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """States (count, nx): half of them at corners of their cells, a quarter on a face, a quarter inside."""
        turns = rng.integers(0, len(self._pools), count)
        chosen = np.array([rng.choice(self._pools[k]) for k in turns], dtype=np.int64)
        nx = self._grid.box.size
        place, sign = rng.uniform(-0.999, 0.999, (count, nx)), rng.integers(0, 2, (count, nx))
        face = np.arange(nx) == rng.integers(0, nx, count)[:, None]
        where = rng.integers(0, 4, count)[:, None]
        pinned = (where < 2) | ((where == 2) & face)
        return points_of_cells(self._grid, chosen, np.where(pinned, 2.0 * sign - 1.0, place))


def beginnings(solution: Solution) -> Ints:
    """Winning cells in which a run does not end at once, (k,)."""
    every = np.ones(solution.grid.size, np.bool_)
    begin = every if solution.target is None else solution.at_first(solution.served)
    return np.flatnonzero(solution.winning & begin)


def _largest(cells: Ints, field: NDArray[np.float32]) -> Ints:
    """Cells whose number is among the largest."""
    limit = np.quantile(field, 1.0 - NARROWEST, method="lower")
    return cells[field >= limit]
