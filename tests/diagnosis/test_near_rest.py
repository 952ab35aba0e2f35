"""Two classes of transitions, slow and fast: a split where it pays, with the coverage asked for in each."""

import numpy as np
import pytest

from simgap.diagnosis.verdict.near_rest import Scored, slow_and_fast

LEVEL = 0.95


def drawn(rng, n, times):
    """Speeds up to 4; scores are `times` as large below 0.5."""
    speed = np.abs(rng.uniform(-4.0, 4.0, n))
    score = np.abs(rng.standard_normal(n)) * np.where(speed <= 0.5, times, 1.0)
    return Scored(score, {"v": speed})


def test_what_sticks_has_a_bound_of_its_own_and_both_cover():
    rng = np.random.default_rng(1)
    slow, fast = [], []
    for _ in range(40):
        split = slow_and_fast(drawn(rng, 2000, 6.0), drawn(rng, 800, 6.0), LEVEL, {"v": 4.0})
        assert split is not None
        assert split.below == pytest.approx(0.5, abs=0.25)
        other = drawn(rng, 4000, 6.0)
        at_rest = other.slow("v", split.below)
        slow.append(np.mean(other.score[at_rest] <= split.slow))
        fast.append(np.mean(other.score[~at_rest] <= split.fast))
    # the mean over draws is at least the level, and not far above it
    assert LEVEL - 0.01 <= np.mean(slow) <= LEVEL + 0.03
    assert LEVEL - 0.01 <= np.mean(fast) <= LEVEL + 0.03


def test_one_bound_where_rest_is_like_motion():
    rng = np.random.default_rng(2)
    assert slow_and_fast(drawn(rng, 2000, 1.0), drawn(rng, 800, 1.0), LEVEL, {"v": 4.0}) is None


def test_one_bound_where_motion_leaves_more():
    rng = np.random.default_rng(3)
    assert slow_and_fast(drawn(rng, 2000, 0.1), drawn(rng, 800, 0.1), LEVEL, {"v": 4.0}) is None


def test_one_bound_where_a_class_would_have_too_few_to_cover():
    rng = np.random.default_rng(4)
    assert slow_and_fast(drawn(rng, 2000, 6.0), drawn(rng, 20, 6.0), LEVEL, {"v": 4.0}) is None
