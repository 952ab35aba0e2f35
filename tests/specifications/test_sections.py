"""What a specification answers: words, ends to draw, the floor, its picture, boxes across the seam of an angle."""

import numpy as np
import pytest

from simgap.closed_loop import Sensing, closed_loop
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.io.figure_style import SURROUNDINGS
from simgap.specifications.arena import first_touch
from simgap.specifications.invariance import Invariance
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space, cells_meeting, cells_within

FLOOR = Space(("x", "y", "t"), Box([0, 0, -np.pi], [4, 3, np.pi]), (2,), {"x": "m", "y": "m", "t": "rad"}, (0, 1, 2))
ANGLE = Space(("q", "v"), Box([-np.pi, -2.0], [np.pi, 2.0]), (0,), {"q": "rad", "v": "rad/s"})
KEYS = {"target": {"x": (3, 4)}, "obstacles": [{"x": (1, 2), "y": (0, 2)}], "clearance": {"x": 0.2, "y": 0.2}}


def test_sentences():
    assert Invariance(kind="invariance", safe={"q": (0, 1)}).sentence(ANGLE) == "stay for ever in q in [0, 1] rad"
    assert ReachAvoid(kind="reach_avoid", **KEYS).sentence(FLOOR) == (
        "reach x in [3, 4] m and avoid 1 obstacle, clear of them and of the walls by 0.2 m in x, 0.2 m in y"
    )
    assert (
        ReachAndStay(kind="reach_and_stay", **KEYS)
        .sentence(FLOOR)
        .startswith("reach x in [3, 4] m, stay there for ever and ")
    )


def test_the_floor_is_that_of_a_body_that_drives():
    asked = ReachAvoid(kind="reach_avoid", **KEYS)
    plane = asked.plane(FLOOR)
    assert (plane.axes, plane.radius) == ((0, 1, 2), 0.2)
    assert (plane.target.lo.tolist(), plane.target.hi.tolist()) == ([3, 0], [4, 3])
    assert plane.obstacles[0].hi.tolist() == [2, 2]
    assert ReachAvoid(kind="reach_avoid", target={"q": (0, 1)}).plane(ANGLE) is None
    assert Invariance(kind="invariance", safe={"x": (0, 1)}).plane(FLOOR) is None


def test_states_that_a_safe_set_does_not_name_keep_all_of_x():
    asked = Invariance(kind="invariance")
    region = asked.region(ANGLE)
    assert (region.lo.tolist(), region.hi.tolist()) == (ANGLE.box.lo.tolist(), ANGLE.box.hi.tolist())
    assert asked.sentence(ANGLE) == "stay for ever in X"


@pytest.mark.parametrize(("ends", "wraps"), [((-np.pi, np.pi), (0,)), ((-np.pi, 1.0), ()), ((-1.0, np.pi), ())])
def test_an_axis_wraps_where_a_region_takes_all_of_it(ends, wraps):
    assert ANGLE.wrapping(Box([ends[0], -1.0], [ends[1], 1.0])) == wraps


def test_what_just_touches_touches():
    assert first_touch(np.array([1.0, 0.5, 0.0, 1.0])) == 2
    assert first_touch(np.array([0.0, 0.5])) == 1  # a start that touches ends in its first step
    assert first_touch(np.array([1.0, 1e-300])) is None


@pytest.mark.parametrize(
    ("keys", "free"),
    [
        ({"obstacles": [{"x": (2.5, 4), "y": (0, 3)}]}, False),
        ({"obstacles": [{"x": (2.9, 3.6)}, {"x": (3.5, 4), "y": (1, 3)}, {"x": (3.5, 4), "y": (0, 1)}]}, False),
        ({"obstacles": [{"x": (2.9, 3.6)}, {"x": (3.5, 4), "y": (1, 3)}, {"x": (3.5, 4), "y": (0, 0.9)}]}, True),
        ({"obstacles": [{"x": (2.9, 3.4)}, {"x": (3.6, 4)}]}, True),
        ({"obstacles": [{"x": (2.9, 3.4)}, {"x": (3.6, 4)}], "clearance": {"x": 0.1}}, False),
        ({"clearance": {"x": 1.0}}, False),
        ({"clearance": {"x": 0.9}}, True),
        ({"target": {"t": (3.0, 3.3)}, "obstacles": [{"t": (2.9, 3.2)}, {"t": (-3.1, -2.9)}]}, False),
        ({"target": {"t": (3.0, 3.3)}, "obstacles": [{"t": (2.9, 3.2)}, {"t": (-3.0, -2.9)}]}, True),
    ],
)
def test_a_target_without_a_free_place_is_refused_before_any_cell_is_made(keys, free):
    asked = ReachAvoid(kind="reach_avoid", **{"target": {"x": (3, 4)}} | keys)
    if free:
        assert asked.region(FLOOR).size == 3
        return
    with pytest.raises(UserError, match="every cell of the target is inside an obstacle or too near") as refused:
        asked.region(FLOOR)
    assert refused.value.key == "synthesis.specification.target"


def test_what_is_drawn():
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    ReachAvoid(kind="reach_avoid", **KEYS).draw(axes, FLOOR, (0, 1), SURROUNDINGS)
    corners = [(*p.get_xy(), p.get_width(), p.get_height()) for p in axes.patches]
    assert corners == [(3, 0, 1, 3), (1, 0, 1, 2), (0, 0, 4, 3)]
    plt.close(figure)


def test_ends_beside_the_states():
    assert Invariance(kind="invariance", safe={"q": (0, 1)}).limits(ANGLE).lo.tolist() == [0, -2]
    assert np.isinf(ReachAvoid(kind="reach_avoid", **KEYS).limits(FLOOR).lo).all()


def test_boxes_across_the_seam_of_an_angle():
    grid = ANGLE.grid(ANGLE.box, (8, 1))
    seam = Box([0.75 * np.pi, -9.0], [1.25 * np.pi, 9.0])
    assert np.flatnonzero(cells_within(grid, seam)).tolist() == [0, 7]
    assert np.flatnonzero(cells_meeting(grid, seam)).tolist() == [0, 7]
    ended = Space(ANGLE.states, ANGLE.box).grid(ANGLE.box, (8, 1))
    assert np.flatnonzero(cells_within(ended, seam)).tolist() == [7]
    assert ReachAvoid(kind="reach_avoid", target={"q": (3.0, 3.3)}).region(ANGLE).hi[0] == np.pi
    with pytest.raises(UserError, match="target lies outside the arena"):
        ReachAvoid(kind="reach_avoid", target={"q": (3.0, 3.3)}).region(Space(ANGLE.states, ANGLE.box))


class Turntable:
    """Turns by u for ever."""

    def reset(self, x):
        self.x = x.copy()

    def advance(self, u):
        self.x = self.x + np.array([u[0], 0.0])
        return self.x


class Constant:
    input_set = np.array([[0.7]])

    def lookup(self, x, pending=0):
        return np.zeros(1, np.int64)


def test_an_angle_that_turns_for_ever_leaves_no_safe_set_that_has_all_of_it():
    monitor = Invariance(kind="invariance", safe={"v": (-1, 1)}).monitor(ANGLE, None)
    still = Sensing(np.zeros(2)), np.random.default_rng(0)
    run = closed_loop(Turntable(), Constant(), np.zeros(2), 60, *still, monitor)
    assert run.x[-1, 0] > 6 * np.pi
    assert monitor.judge(run, 60).outcome.end == "stayed"


def test_a_target_counts_in_every_turn():
    grid = ANGLE.grid(ANGLE.box, (64, 1))
    value = np.where(cells_within(grid, Box([2.8, -9], [3.4, 9])), 0, 5).astype(np.int32)
    flags = np.ones(64, bool)
    solution = Solution(grid, flags, np.zeros((64, 1), np.uint8), flags, value, value == 0)
    asked = ReachAvoid(kind="reach_avoid", target={"q": (2.8, 3.4)})
    monitor = asked.monitor(ANGLE, solution)
    still = Sensing(np.zeros(2)), np.random.default_rng(0)
    run = closed_loop(Turntable(), Constant(), np.array([3.7, 0.0]), 60, *still, monitor)  # past it: a whole turn first
    verdict = monitor.judge(run, 60)
    assert (verdict.outcome.end, verdict.outcome.kept) == ("reached the target", True)
    assert verdict.run.x[-1, 0] > 2 * np.pi + 2.8
