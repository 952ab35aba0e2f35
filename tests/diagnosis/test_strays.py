"""Readings that stand alone, by hand."""

import numpy as np
import pytest

from simgap.diagnosis.verdict.judge import strays

ROWS = np.array([0, 200, 400])


def residual(**at):
    made = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 2))
    for where, value in at.items():
        made[int(where[1:]), 0] = value
    return made


@pytest.mark.parametrize("at", [{"r50": 8.0}, {"r50": -8.0}, {"r0": 8.0}, {"r199": 8.0}, {"r200": -8.0}, {"r399": 8.0}])
def test_a_lone_reading_is_one(at):
    ((where, value),) = at.items()
    found = strays(residual(**at), ROWS)
    assert np.argwhere(found).tolist() == [[int(where[1:]), 0]]
    assert abs(value) > 5.0


@pytest.mark.parametrize("at", [{"r50": 8.0, "r51": 3.5}, {"r50": 8.0, "r49": -6.0}, {"r50": 4.9}])
def test_what_lasts_or_is_small_is_none(at):
    assert not strays(residual(**at), ROWS).any()


def test_the_end_of_a_window_is_no_neighbour_of_the_next():
    assert np.argwhere(strays(residual(r199=8.0, r200=4.0), ROWS)).tolist() == [[199, 0]]


def test_many_are_something_else():
    many = {f"r{k}": 8.0 for k in range(2, 400, 15)}
    assert not strays(residual(**many), ROWS).any()
    assert strays(residual(r2=8.0, r42=8.0), ROWS).sum() == 2
