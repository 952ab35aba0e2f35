"""By how much targets shrink and obstacles grow, against inequalities written out for every cell."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.specifications.reaching import ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.intersample import Flow, excursion

BOX = Box([0.0, 0.0], [10.0, 8.0])
SPACE = Space(("x", "y"), BOX, (), {}, None)
GRID = Grid(BOX, [40, 32])
ERROR, STRAY = np.array([0.3, 0.1]), np.array([0.2, 0.4])


def section():
    return ReachAvoid(
        kind="reach_avoid", target={"x": (6.0, 9.0), "y": (5.0, 7.5)}, obstacles=({"x": (2.0, 3.0), "y": (0.0, 4.0)},),
        clearance={"x": 0.25, "y": 0.15},
    )  # fmt: skip


def game():
    return SimpleNamespace(space=SPACE, grid=GRID, error=ERROR, stray=STRAY)


def faces():
    k = np.stack(np.unravel_index(np.arange(GRID.size), GRID.cells), axis=1)
    return k * 0.25, (k + 1) * 0.25


def test_a_target_shrinks_by_the_measurement_error():
    """A cell counts if the true state is in the target whatever in it was measured."""
    lo, hi = faces()
    inside = (lo[:, 0] - 0.3 >= 6.0) & (hi[:, 0] + 0.3 <= 9.0) & (lo[:, 1] - 0.1 >= 5.0) & (hi[:, 1] + 0.1 <= 7.5)
    assert inside.any()
    assert np.array_equal(section().goal(game()), inside)


def test_free_cells_keep_clearance_stray_and_error_from_obstacles_and_walls():
    lo, hi = faces()
    keep = np.array([0.25, 0.15]) + ERROR + STRAY
    walls = np.all((lo - keep >= 0.0) & (hi + keep <= [10.0, 8.0]), axis=1)
    meets = (hi[:, 0] > 2.0 - keep[0] + 1e-9) & (lo[:, 0] < 3.0 + keep[0] - 1e-9) & (lo[:, 1] < 4.0 + keep[1] - 1e-9)
    target, free = section().sets(game())
    assert np.array_equal(free, walls & ~meets)
    assert np.array_equal(target, section().goal(game()) & free)


def test_walls_of_a_box_may_need_less_than_obstacles():
    from_obstacles, from_walls = STRAY, 0.25 * STRAY
    lo, hi = faces()
    keep, beyond = (np.array([0.25, 0.15]) + margin for margin in (from_obstacles, from_walls))
    walls = np.all((lo - beyond >= 0.0) & (hi + beyond <= [10.0, 8.0]), axis=1)
    meets = (hi[:, 0] > 2.0 - keep[0] + 1e-9) & (lo[:, 0] < 3.0 + keep[0] - 1e-9) & (lo[:, 1] < 4.0 + keep[1] - 1e-9)
    own = game()
    free = section().free(own.space, own.grid, np.stack([from_obstacles, from_walls]))
    assert np.array_equal(free, walls & ~meets)
    assert free.sum() > section().free(own.space, own.grid, from_obstacles).sum()


def test_half_a_sampling_time_at_the_largest_rate_and_what_is_added():
    def rates(lo, hi, u):
        return np.full(lo.shape, -3.0), np.full(lo.shape, 2.0) + u

    (reach, walls), speed = excursion(Flow(rates), BOX, np.array([[0.0], [0.5]]), 0.1, np.array([0.0, 1.0]))
    assert np.all(reach >= [0.15, 0.2])
    assert reach == pytest.approx([0.15, 0.2], rel=1e-5)
    assert np.array_equal(walls, reach)  # of rates alone nothing is known that would spare a wall
    assert speed == pytest.approx([3.0, 4.0])

    def growing(lo, hi, u):
        return lo, hi

    (reach, _), _ = excursion(Flow(growing), Box([-1.0, -1.0], [1.0, 1.0]), np.zeros((1, 1)), 0.2)
    assert np.all(reach >= 0.1 * (1.0 + reach))  # the rates hold where the path may be
