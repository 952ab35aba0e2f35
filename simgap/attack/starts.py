"""Where the adversary begins: faces and corners of the cells that are won most narrowly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.attack.danger import Danger
from simgap.geometry import Floats, points_of_cells
from simgap.specifications.solution import Solution

NARROWEST = 0.02  # share of the cells, or all of the same number, from which narrow ones are drawn


def worst_starts(
    solution: Solution, danger: Danger, margin: NDArray[np.float32] | None, count: int, rng: np.random.Generator
) -> Floats:
    """States of winning cells in which a run does not end at once: (count, nx).

    A quarter each from cells of the smallest `margin` (cells,) if it is known, from those at the edge of the winning
    domain, from those of the greatest level, and from all. Half are at corners, a quarter on faces.
    """
    begin = solution.at_first(solution.served) if solution.target is not None else np.ones(solution.grid.size, bool)
    cells = np.flatnonzero(solution.winning & begin)
    fields = [np.zeros(len(cells)), danger.edge[cells]]
    fields += [-margin[cells]] if margin is not None else []
    fields += [danger.level[cells]] if danger.level is not None else []
    pools = [_largest(cells, np.nan_to_num(field, nan=-np.inf)) for field in fields]
    chosen = np.array([rng.choice(pools[k % len(pools)]) for k in range(count)], dtype=np.int64)
    nx = solution.grid.box.size
    place, corner = rng.uniform(-0.999, 0.999, (count, nx)), np.where(rng.integers(0, 2, (count, nx)) == 1, 1.0, -1.0)
    face = np.arange(nx) == rng.integers(0, nx, count)[:, None]
    where = rng.integers(0, 4, count)[:, None]
    return points_of_cells(solution.grid, chosen, np.where((where < 2) | ((where == 2) & face), corner, place))


def _largest(cells: NDArray[np.int64], field: Floats) -> NDArray[np.int64]:
    """Cells whose number is among the largest."""
    limit = np.quantile(field, 1.0 - NARROWEST, method="lower")
    return cells[field >= limit]
