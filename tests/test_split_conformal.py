"""The reach of scores against a count by hand, and its coverage against the law that it is drawn from."""

import math

import numpy as np
import pytest

from simgap.statistics import attained, fewest, reach


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


def test_pieces_weigh_alike_whatever_their_size():
    scores, piece = np.array([1.0, 2.0, 3.0, 4.0, 9.0]), np.array([7, 7, 7, 7, 2])
    # three shares of a third: four scores of a twelfth each, then nine, then what is above all
    assert reach(scores, 0.25, piece) == 3.0
    assert reach(scores, 1 / 3, piece) == 4.0
    assert reach(scores, 0.34, piece) == 9.0
    assert reach(scores, 2 / 3, piece) == 9.0
    assert reach(scores, 0.67, piece) == math.inf


@pytest.mark.parametrize(("pieces", "left"), [(1, 0.5), (3, 0.75), (18, 18 / 19), (19, 0.95), (100, 0.95)])
def test_what_pieces_leave_of_a_level(pieces, left):
    assert attained(pieces, 0.95) == left
    assert math.isfinite(reach(np.zeros(pieces), left, np.arange(pieces)))


def test_a_piece_a_score_is_the_rank_of_the_textbook():
    rng = np.random.default_rng(3)
    for n in (4, 19, 57):
        scores = rng.random(n)
        for level in (0.5, 0.8, 0.9, 0.95, 0.99):
            assert reach(scores, level, rng.permutation(n)) == reach(scores, level)


def test_pieces_of_equal_scores_cover():
    """Each piece is one draw, repeated up to fifty times: the coverage is that of the draws."""
    rng, inside = np.random.default_rng(4), []
    for _ in range(3000):
        sizes = rng.integers(1, 50, 9)
        inside.append(reach(np.repeat(rng.random(9), sizes), 0.9, np.repeat(np.arange(9), sizes)))
    assert np.mean(inside) == pytest.approx(0.9, abs=0.006)  # the largest of nine uniform draws
