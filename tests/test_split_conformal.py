"""The reach of scores against a count by hand, and its coverage against the law that it is drawn from."""

import math

import numpy as np
import pytest

from simgap.split_conformal import fewest, reach


def test_the_rank_is_that_of_the_textbook():
    scores = np.array([7.0, 1.0, 5.0, 3.0, 9.0, 2.0, 8.0, 4.0, 6.0])
    assert reach(scores, 0.9) == 9.0  # ceil(10 * 0.9) = 9th
    assert reach(scores, 0.5) == 5.0
    assert reach(scores, 0.95) == math.inf  # the 10th of nine


@pytest.mark.parametrize(("level", "count"), [(0.5, 1), (0.8, 4), (0.9, 9), (0.95, 19), (0.99, 99)])
def test_the_fewest_scores_are_the_first_with_a_finite_reach(level, count):
    assert fewest(level) == count
    assert math.isfinite(reach(np.zeros(count), level))
    assert math.isinf(reach(np.zeros(count - 1), level))


def test_coverage():
    rng = np.random.default_rng(0)
    reaches = np.array([reach(rng.random(19), 0.9) for _ in range(4000)])
    # the 18th of 19 uniform scores is Beta(18, 2) distributed: 0.9 in the mean, and that is the coverage
    assert reaches.mean() == pytest.approx(0.9, abs=0.004)
