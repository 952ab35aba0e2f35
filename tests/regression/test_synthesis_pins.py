"""Pinned counts. To add a row, run `python benchmarks/synthesis.py` and confirm the count with another tool first."""

import pytest
from pinned_problems import PENDULUM, UNICYCLE, pendulum, unicycle

from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid


@pytest.mark.parametrize("cells", PENDULUM)
def test_invariance_of_the_pendulum(cells):
    found = invariance(pendulum(cells))
    assert (int(found.winning.sum()), found.pairs) == PENDULUM[cells]


@pytest.mark.parametrize("row", UNICYCLE)
def test_reach_of_the_unicycle_on_bit_rows(row):
    found = reach_avoid(*unicycle(*row))
    assert (int(found.winning.sum()), found.steps, found.backend) == (*UNICYCLE[row], "bit_rows")


def test_reach_of_the_unicycle_by_table():
    row = next(iter(UNICYCLE))
    found = reach_avoid(*unicycle(*row), by_rows=False)
    assert (int(found.winning.sum()), found.steps, found.backend) == (*UNICYCLE[row], "table")
