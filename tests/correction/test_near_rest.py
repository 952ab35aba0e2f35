"""Two classes of transitions, slow and fast: a split where it pays, with the coverage asked for in each."""

import numpy as np
import pytest

from simgap.correction.conformal_bound import Sizes, bound, slow_and_fast

LEVEL = 0.95


def drawn(rng, n, times):
    """Speeds up to 4; residuals of two states, `times` as large below 0.5."""
    speed = np.abs(rng.uniform(-4.0, 4.0, n))
    size = np.abs(rng.standard_normal((n, 2))) * [1.0, 0.01] * np.where(speed <= 0.5, times, 1.0)[:, None]
    return Sizes(size, {"v": speed})


def inside(sizes, limit):
    return np.all(sizes.residual <= limit, axis=1)


def test_all_states_at_once_are_inside_as_often_as_was_asked():
    rng, shares = np.random.default_rng(0), []
    for _ in range(100):
        limit = bound(drawn(rng, 400, 1.0), drawn(rng, 200, 1.0), LEVEL)
        shares.append(np.mean(inside(drawn(rng, 2000, 1.0), limit)))
        assert limit[1] == pytest.approx(0.01 * limit[0], rel=0.4)  # both states are met alike
    assert LEVEL <= np.mean(shares) <= LEVEL + 0.02


def test_what_sticks_has_a_bound_of_its_own_and_both_cover():
    rng = np.random.default_rng(1)
    slow, fast = [], []
    for _ in range(40):
        split = slow_and_fast(drawn(rng, 2000, 6.0), drawn(rng, 800, 6.0), LEVEL, {"v": 4.0})
        assert split is not None
        assert split.own
        assert split.below == pytest.approx(0.5, abs=0.25)
        other = drawn(rng, 4000, 6.0)
        at_rest = other.speed["v"] <= split.below
        slow.append(np.mean(inside(other, split.slow)[at_rest]))
        fast.append(np.mean(inside(other, split.fast)[~at_rest]))
    assert LEVEL - 0.01 <= np.mean(slow) <= LEVEL + 0.04
    assert LEVEL - 0.01 <= np.mean(fast) <= LEVEL + 0.04


@pytest.mark.parametrize("times", [1.0, 0.1])
def test_one_bound_where_rest_leaves_no_more_than_motion(times):
    rng = np.random.default_rng(2)
    assert slow_and_fast(drawn(rng, 2000, times), drawn(rng, 800, times), LEVEL, {"v": 4.0}) is None


def test_too_few_slow_ones_take_the_bound_of_all_and_still_cover():
    """60 held-out transitions have about seven slow ones, of which 19 would be needed."""
    rng, shares = np.random.default_rng(4), []
    for _ in range(60):
        fitted, fresh = drawn(rng, 2000, 6.0), drawn(rng, 60, 6.0)
        split = slow_and_fast(fitted, fresh, LEVEL, {"v": 4.0})
        assert split is not None
        assert not split.own
        assert np.all(split.slow >= bound(fitted, fresh, LEVEL))
        other = drawn(rng, 4000, 6.0)
        at_rest = other.speed["v"] <= split.below
        shares.append(np.mean(np.where(at_rest, inside(other, split.slow), inside(other, split.fast))))
    assert np.mean(shares) >= 2.0 * LEVEL - 1.0


def test_no_bound_of_two_classes_from_too_few_altogether():
    rng = np.random.default_rng(5)
    assert slow_and_fast(drawn(rng, 2000, 6.0), drawn(rng, 15, 6.0), LEVEL, {"v": 4.0}) is None
    assert np.all(np.isinf(bound(drawn(rng, 2000, 6.0), drawn(rng, 15, 6.0), LEVEL)))


def test_the_bound_is_never_narrower_than_what_fitted_transitions_leave():
    rng = np.random.default_rng(6)
    calm, rough = drawn(rng, 300, 1.0), drawn(rng, 300, 5.0)
    assert np.all(bound(rough, calm, LEVEL) >= np.quantile(rough.residual, LEVEL, axis=0))
    assert np.mean(inside(rough, bound(rough, calm, LEVEL))) >= LEVEL
