"""The directed search against objectives whose maximum is known."""

import numpy as np
import pytest

from simgap.gap.memory.search import Histories, directed_search

SPACE = Histories((21, 21), 3)


def needle(values, headings):
    """Large where three inputs in a row and the heading are right: best 0, at (10, 3), (17, 20), (20, 20) and 1.2."""
    off = np.abs(values - np.array([[10, 3], [17, 20], [20, 20]])).sum(axis=(1, 2))
    return -(off + 3.0 * np.abs(np.sin(0.5 * (headings - 1.2))))


def test_it_finds_what_random_draws_do_not():
    for seed in range(5):
        found = directed_search(needle, SPACE, 4000, np.random.default_rng(seed))
        drawn = needle(*SPACE.draw(4000, np.random.default_rng(seed)))
        assert found.scores[0] > -3
        assert found.scores[0] > 0.3 * drawn.max()  # scores are negative


def test_the_budget_is_kept_and_what_was_tried_is_given_back_worst_first():
    asked = []

    def objective(values, headings):
        asked.append(len(values))
        return needle(values, headings)

    found = directed_search(objective, SPACE, 1003, np.random.default_rng(0))
    assert sum(asked) == len(found.scores) == 1003
    assert np.all(np.diff(found.scores) <= 0)
    values, headings = found.points
    assert np.array_equal(found.scores, needle(values, headings))
    assert values.min() >= 0
    assert values.max() <= 20
    assert np.abs(headings).max() <= np.pi
    assert len(found.worst(7).scores) == 7


def test_the_same_seed_finds_the_same_and_given_seeds_are_tried():
    one, two = (directed_search(needle, SPACE, 500, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.points[0], two.points[0])
    best = np.array([[[10, 3], [17, 20], [20, 20]]]), np.array([1.2])
    assert directed_search(needle, SPACE, 200, np.random.default_rng(0), seeds=best).scores[0] == pytest.approx(0)


def test_a_heading_that_is_not_searched_stays_zero():
    found = directed_search(needle, Histories((21, 21), 3, turns=False), 300, np.random.default_rng(0))
    assert not found.points[1].any()
