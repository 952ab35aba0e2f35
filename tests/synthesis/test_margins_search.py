"""The search for a margin finds what the same search finds with every question answered from the definition."""

import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.synthesis.abstraction.cells import count_holes, layout
from simgap.synthesis.abstraction.post import Frame
from simgap.synthesis.margins import RESOLUTION, _largest

GRID = Grid(Box([0.0, -1.0], [3.0, 1.0]), (40, 30), (1,))


def inside(cells, lo, hi):
    """Whether every cell that [lo, hi] touches is in the set (40, 30) bool; axis 1 goes round, axis 0 has ends."""
    width = 2.0 * GRID.h
    pad = Frame(GRID, np.zeros((1, 1)), np.zeros(2)).header[-2:]
    first = np.floor((lo - pad - GRID.box.lo) / width).astype(int)
    last = np.floor((hi + pad - GRID.box.lo) / width).astype(int)
    if first[0] < 0 or last[0] >= 40:
        return False
    rows = np.arange(first[0], last[0] + 1)
    columns = np.arange(first[1], min(last[1], first[1] + 29) + 1) % 30
    return bool(cells[np.ix_(rows, columns)].all())


def by_asking(cells, lo, hi, by, best, most):
    """The search with every one of its questions answered from the definition."""

    def fits(size):
        return inside(cells, lo - size * by, hi + size * by)

    if best < 0.0:
        if not fits(0.0):
            return best
        best = 0.0
    low, high = max(best * (1.0 + RESOLUTION), most * 1e-9), most
    if not fits(low):
        return best
    if fits(most):
        return most
    while high > low * (1.0 + RESOLUTION):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


@pytest.mark.parametrize("seed", range(3))
def test_the_largest_growth_is_that_of_the_definition(seed):
    rng = np.random.default_rng(seed)
    cells = rng.random((40, 30)) > 0.004
    shape = layout(GRID.cells, GRID.periodic)
    tables = count_holes(cells.reshape(-1), shape, 2)[None]
    header, found = Frame(GRID, np.zeros((1, 1)), np.zeros(2)).header, set()
    for _ in range(150):
        centre, half = rng.uniform([0.1, -1.0], [2.9, 1.0]), rng.uniform(0.0, 0.08, 2)
        by = rng.choice([rng.uniform(0.0, 1.0, 2), [1.0, 0.0], [0.0, 1.0]])
        best, most = float(rng.choice([-1.0, 0.0, rng.uniform(0.0, 0.3)])), float(rng.choice([3.0, 9999.0]))
        lo, hi = centre - half, centre + half
        if best >= 0.0 and not inside(cells, lo - best * by, hi + best * by):
            continue  # an earlier input's best says nothing of this box
        expected = by_asking(cells, lo, hi, by, best, most)
        found.add(expected)
        own = _largest(shape, 2, tables, 0, lo, hi, by, best, most, header, np.empty(4, np.int64))
        assert own == expected
    assert len(found) > 50
