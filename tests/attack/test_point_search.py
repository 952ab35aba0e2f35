"""The power of the search over states and inputs: planted faults that uniform samples of the same budget miss."""

import numpy as np
import pytest

from simgap.attack.worst_step import GapProblem, search_points, share, worst_first
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.borders import critical_points
from simgap.geometry import Box

BOX = Box([-1.0, -2.0], [1.0, 2.0])
INPUTS = np.linspace(-1.0, 1.0, 21)[:, None]
BUDGET = 20_000


def smooth(x, u):
    """A gap with its largest value in the interior, at (0.3137, -0.7, 0.4), and other hills beside it."""
    near = (x[:, 0] - 0.3137) ** 2 + (x[:, 1] / 2 + 0.35) ** 2 + 0.2 * (u[:, 0] - 0.4) ** 2
    other = (x[:, 0] + 0.6) ** 2 + (x[:, 1] / 2 - 0.5) ** 2
    return np.exp(-3 * near) + 0.9 * np.exp(-6 * other)


def at_a_corner(x, u):
    """A gap that is largest at one corner of X, under one input."""
    return x[:, 0] - 0.5 * x[:, 1] + 0.1 * u[:, 0]


def jump_on_a_face(x, u):
    """Coulomb friction at rest: it sticks on the lower end of x2 alone."""
    return np.where(x[:, 1] == -2.0, 1.0, 0.2 * np.sin(3 * x[:, 0]))


FAULTS = {smooth: None, at_a_corner: 2.1, jump_on_a_face: 1.0}


def question(gap, top):
    """A nominal model that does nothing, a simulator that has the gap in x1, and a bound that ends at `top`."""

    def successors(x, u):
        following = x + np.stack([gap(x, u), np.zeros(len(x))], axis=1)
        return following, following

    def bounds(x, u):
        lo, hi = np.full(x.shape, -3.0), np.full(x.shape, 1.0)
        hi[:, 0] = top
        return lo, hi

    places = critical_points(GapDomain(("x1", "x2"), ("u",), BOX, INPUTS)).x
    return GapProblem(successors, lambda x, u: x.copy(), bounds, BOX, INPUTS, places)


def largest(gap):
    """The supremum on a fine mesh and a local refinement, independent of the search."""
    if FAULTS[gap] is not None:
        return FAULTS[gap]
    from scipy.optimize import minimize

    best = -np.inf
    for u in INPUTS[:, 0]:
        for start in ((0.3, -0.7), (-0.6, 1.0)):
            found = minimize(lambda x, u=u: -gap(x[None], np.array([[u]]))[0], start, tol=1e-14)
            best = max(best, -found.fun)
    return best


@pytest.mark.parametrize("gap", FAULTS, ids=lambda g: g.__name__)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_planted_fault_is_found_that_random_samples_miss(gap, seed):
    """The bound lacks a millionth of the gap, or a jump on a set of measure zero."""
    top = largest(gap) - (1e-6 if gap is not jump_on_a_face else 0.5)
    asked = question(gap, top)
    rng = np.random.default_rng(seed)
    x, m = BOX.sample(rng, BUDGET), rng.integers(0, len(INPUTS), BUDGET)
    at_random = gap(x, INPUTS[m])
    assert (at_random <= top).all()
    known = worst_first(BOX, x, at_random, 200)
    found = search_points(asked, BUDGET, rng, x[known], m[known])
    assert found.violations > 0
    assert found.evaluations <= BUDGET
    worst = found.worst
    assert worst.share > 0
    assert gap(worst.x[None], worst.u[None])[0] == pytest.approx(worst.d[0])
    assert worst.d[0] > worst.hi[0]


@pytest.mark.parametrize("gap", FAULTS, ids=lambda g: g.__name__)
def test_a_bound_that_holds_is_not_accused(gap):
    asked = question(gap, largest(gap) + 1e-9)
    found = search_points(asked, BUDGET, np.random.default_rng(4), np.empty((0, 2)), np.empty(0, np.int64))
    assert found.violations == 0
    assert found.worst.share < 0.0
    assert sum(found.by.values()) == found.evaluations >= 0.99 * BUDGET


def test_the_search_goes_farther_than_random_samples_in_the_interior():
    gap, rng = smooth, np.random.default_rng(7)
    x, m = BOX.sample(rng, BUDGET), rng.integers(0, len(INPUTS), BUDGET)
    top = largest(gap)
    found = search_points(question(gap, top + 1e-9), BUDGET, rng, np.empty((0, 2)), np.empty(0, np.int64))
    missing_at_random, missing = top - gap(x, INPUTS[m]).max(), -found.worst.share * (top + 3.0)
    assert missing < 1e-6 < 1e-5 < missing_at_random


def test_a_share_is_measured_in_widths_of_the_bound():
    lo, hi = np.array([[0.0, -1.0]]), np.array([[2.0, 1.0]])
    middle = np.array([[1.0, 0.0]])
    assert share(middle, middle, lo, hi)[0] == -0.5
    assert share(np.array([[1.0, -1.5]]), np.array([[1.0, 0.0]]), lo, hi)[0] == 0.25
    assert share(np.array([[np.nan, 0.0]]), middle, lo, hi)[0] == np.inf
