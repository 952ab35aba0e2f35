"""Distances checked by hand, and how runs towards a target end on a robot that does exactly as it is told."""

import numpy as np
import pytest

from simgap.closed_loop import Sensing, closed_loop
from simgap.geometry import Box, Grid
from simgap.specifications.arena import Surroundings
from simgap.specifications.base import Run
from simgap.specifications.reaching import LATE, LEFT, REACHED, STAYED, ReachAndStay, ReachAvoid, Staying
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space, cells_meeting, partial_box

SPACE = Space(("x", "y", "t"), Box([0, 0, -np.pi], [10, 10, np.pi]), (2,), pose=(0, 1, 2))
WALL = {"x": (4.0, 5.0), "y": (0.0, 6.0)}


def around(space=SPACE, obstacles=(WALL,), clearance=0.2):
    boxes = tuple(partial_box(o, space.states) for o in obstacles)
    return Surroundings.of(space, boxes, space.box, np.array([clearance, clearance, 0.0])[: space.size])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((3.0, 3.0), 0.8),
        ((0.3, 8.0), 0.1),
        ((8.0, 10.0), -0.2),
        ((2.0, 9.0), 0.8),
        ((4.1, 3.0), -0.3),
        ((1.0, 10.0), -0.2),
        ((5.3, 6.4), 0.3),
    ],
)
def test_a_round_footprint_has_a_euclidean_distance(point, distance):
    assert around().least(np.array([[*point, 40.0]])) == pytest.approx(distance)


def test_a_path_takes_its_worst_point():
    path = np.array([[8.0, 5.0, 0], [5.3, 6.4, 0], [7.0, 7.0, 0]])
    assert around().least(path) == pytest.approx(0.3)
    assert around().distances(path).tolist() == [pytest.approx(v) for v in (1.8, 0.3, np.sqrt(5) - 0.2)]


def test_states_of_other_plants_are_compared_in_widths_of_X():
    plant = Space(("q", "v"), Box([-1.0, -10.0], [1.0, 10.0]))
    near = around(plant, ({"q": (0.5, 0.7), "v": (2.0, 4.0)},), 0.0)
    assert not near.round
    assert near.least(np.array([[0.3, 3.0]])) == pytest.approx(0.1)  # 0.2 of 2
    assert near.least(np.array([[0.6, 1.0]])) == pytest.approx(0.05)  # 1 of 20
    assert near.least(np.array([[0.4, -1.0]])) == pytest.approx(0.15)  # the farther axis counts
    assert near.least(np.array([[0.6, 3.0]])) < 0
    assert near.least(np.array([[1.1, 0.0]])) < 0


def test_a_box_on_a_periodic_axis_has_copies_in_every_turn():
    plant = Space(("q", "v"), Box([-np.pi, -1.0], [np.pi, 1.0]), (0,))
    near = around(plant, ({"q": (3.0, 3.3)},), 0.0)
    q = np.array([3.1, 3.1 - 2 * np.pi, 3.1 + 4 * np.pi, -3.0, 0.0, 100 * np.pi])
    d = near.distances(np.stack([q, 0 * q], axis=1)) * 2 * np.pi
    assert np.all(d[:3] < 0)
    assert d[3] == pytest.approx(2 * np.pi - 3.0 - 3.3)
    assert np.all(d[4:] > 2.5)


class Cart:
    """Moves by u along x at once, with five poses on the path."""

    def reset(self, x):
        self.x, self.path = x.copy(), x[None]

    def advance(self, u):
        share = np.linspace(0.2, 1.0, 5)[:, None]
        self.path = self.x + share * np.array([u[0], 0.0, 0.0])
        self.x = self.path[-1].copy()
        return self.x


class Blind(Cart):
    """The same without its path."""

    def reset(self, x):
        self.x = x.copy()

    def advance(self, u):
        self.x = self.x + np.array([u[0], 0.0, 0.0])
        return self.x


class Always:
    input_set = np.array([[0.5], [-0.5]])

    def __init__(self, chosen):
        self.chosen = chosen

    def lookup(self, x, pending=0):
        return np.array([self.chosen(x[0])])


def by_x(level):
    """A solution whose value depends on x alone, in 100 cells of 0.1 m."""
    grid = SPACE.grid(SPACE.box, (100, 1, 1))
    value = np.array([level(x) for x in grid.axis(0)], dtype=np.int32)
    flags = value >= 0
    return Solution(grid, flags, np.zeros((100, 1), np.uint8), flags, value, value == 0)


def go(chosen, level, start=1.0, steps=20, plant=Cart, kind=ReachAvoid, obstacles=(WALL,), clearance=0.2):
    name = "reach_avoid" if kind is ReachAvoid else "reach_and_stay"
    keep = {"x": clearance, "y": clearance}
    asked = kind(kind=name, obstacles=obstacles, target={"x": (2.9, 3.5)}, clearance=keep)
    monitor = asked.monitor(SPACE, by_x(level))
    sensing, rng = Sensing(np.zeros(3)), np.random.default_rng(0)
    run = closed_loop(plant(), Always(chosen), np.array([start, 3.0, 0.0]), steps, sensing, rng, monitor)
    return monitor.judge(run, steps), monitor


RIGHT, LEFTWARD = (lambda x: 0), (lambda x: 1)


def coming(x):
    return max(0, int(np.ceil((2.9 - x) / 0.5)))


@pytest.mark.parametrize("plant", [Cart, Blind])
def test_ends(plant):
    reached, monitor = go(RIGHT, coming, plant=plant)
    assert (reached.outcome.end, reached.outcome.kept, reached.outcome.steps) == (REACHED, True, 4)
    assert monitor.summary([reached.outcome]) == {
        "steps_to_target": [4], "steps_that_left_the_certified_box": 0, "least_clearance": pytest.approx(0.8),
    }  # fmt: skip
    hit, _ = go(RIGHT, lambda x: 99, plant=plant)
    assert (hit.outcome.end, hit.outcome.kept) == ("collision", False)
    assert hit.outcome.figures["clearance"] < 0
    assert hit.safe.tolist() == [True] * (len(hit.run.x) - 1) + [False]
    assert go(LEFTWARD, lambda x: 5, steps=1, plant=plant)[0].outcome.end == LATE
    assert go(lambda x: -1, lambda x: 5, plant=plant)[0].outcome.end == "no admissible input"


def test_a_target_cell_beside_the_target_is_no_arrival():
    verdict, _ = go(RIGHT, lambda x: 0 if x > 2.2 else 3)
    assert (verdict.outcome.end, verdict.outcome.kept) == ("ended beside the target", False)


@pytest.mark.parametrize("plant", [Cart, Blind])
def test_a_collision_between_samples_is_seen(plant):
    thin = ({"x": (3.05, 3.1), "y": (0.0, 6.0)},)
    verdict, _ = go(RIGHT, lambda x: 7, 2.8, 1, plant, obstacles=thin, clearance=0.01)
    assert verdict.outcome.end == "collision"  # 2.8 and 3.3 are clear, 3.1 is not


def test_climbs_count_steps_after_which_the_value_had_not_fallen():
    values = {1.0: 5, 1.5: 4, 2.0: 4, 2.5: -1, 3.0: 2, 3.5: 1}
    verdict, _ = go(RIGHT, lambda x: values.get(round(float(np.floor(x * 10 + 1e-9) / 10), 1), 9), steps=5)
    assert verdict.outcome.figures["climbs"] == 3  # 4 -> 4, 4 -> -1, -1 -> 2


def test_staying_goes_on_to_the_last_sample():
    shuttle = lambda x: 0 if x[0] < 3.2 else 1  # noqa: E731 - 1.0, ..., 3.0, 3.5, 3.0, ...
    stayed, monitor = go(shuttle, coming, kind=ReachAndStay)
    assert (stayed.outcome.end, stayed.outcome.kept, stayed.outcome.steps) == (STAYED, True, 20)
    assert monitor.summary([stayed.outcome])["steps_to_target"] == [4]
    left, _ = go(lambda x: 0 if x[0] < 2.9 else 1, coming, kind=ReachAndStay)
    assert (left.outcome.end, left.outcome.kept) == (LEFT, False)
    assert go(LEFTWARD, coming, steps=1, kind=ReachAndStay)[0].outcome.end == LATE


def test_unwinding_moves_state_and_successor_alike():
    space = Space(("x", "t"), Box([0, -np.pi], [2, np.pi]), (1,))
    x, following = np.array([[1.0, 7.0], [1.0, -4.0]]), np.array([[2.0, 7.5], [2.0, -4.5]])
    a, b = space.unwound(x, following)
    assert np.all((a[:, 1] >= -np.pi) & (a[:, 1] < np.pi))
    assert np.allclose(b - a, following - x)


def test_a_region_that_cuts_a_period_does_not_wrap():
    space = Space(("x", "t"), Box([0, -np.pi], [2, np.pi]), (1,))
    assert space.grid(space.box, (4, 8)).periodic == (1,)
    assert space.grid(Box([0, -1.0], [2, 1.0]), (4, 8)).periodic == ()


@pytest.mark.parametrize("periodic", [(), (0,), (0, 1)])
def test_the_finder_is_the_grids_own_on_every_bit(periodic):
    grid = Grid(Box([-1.0, 0.0], [1.0, 3.0]), (37, 5), periodic)
    edges = grid.box.lo[0] + 2.0 * grid.h[0] * np.arange(38)
    first = np.concatenate([edges, np.nextafter(edges, 9), np.nextafter(edges, -9), np.linspace(-1.2, 1.2, 500)])
    points = np.stack([first, np.resize([0.0, 0.6, 3.0, 3.1, -0.1, 1.7], len(first))], axis=1)
    find = grid.finder()
    assert [find(p) for p in points] == grid.index(points).tolist()


@pytest.mark.parametrize(
    ("ends", "box", "inside", "outside"),
    [
        ((-np.pi, np.pi), (10.0, 11.0), 10.5 - 4 * np.pi, 0.5),  # an obstacle more than a turn away from X
        ((360.0, 720.0), (600.0, 620.0), 610.0, 500.0),  # X far from 0
        ((20.0, 20.0 + 2 * np.pi), (21.0, 22.0), 21.5, 25.0),
    ],
)
def test_a_box_any_number_of_turns_away_blocks_and_is_judged(ends, box, inside, outside):
    space = Space(("a", "v"), Box([ends[0], -1.0], [ends[1], 1.0]), (0,))
    obstacle = partial_box({"a": box}, space.states)
    grid = Grid(space.box, (72, 1), (0,))
    blocked = cells_meeting(grid, obstacle)
    assert blocked.sum() == pytest.approx(72 * (box[1] - box[0]) / (ends[1] - ends[0]), abs=2)
    cells = grid.index(np.array([[inside, 0.0], [outside, 0.0]]))
    assert blocked[cells].tolist() == [True, False]
    near = around(space, ({"a": box},), 0.0)
    turns = (ends[1] - ends[0]) * np.arange(-3, 4)
    for at, sign in ((inside, -1), (outside, 1)):
        points = np.stack([at + turns, np.zeros(len(turns))], axis=1)
        assert (np.sign(near.distances(points)) == sign).all()


def test_a_run_that_leaves_the_target_again_is_marked_from_there_on():
    around_it = around(clearance=0.1)
    target = partial_box({"x": (8.0, 9.0)}, SPACE.states)
    grid = Grid(SPACE.box, (10, 10, 1), (2,))
    value = np.where(grid.centres()[:, 0] > 8.0, 0, 1).astype(np.int32)
    free = np.ones(grid.size, np.bool_)
    solution = Solution(grid, free, np.ones((grid.size, 1), np.bool_), free, value, value == 0)
    x = np.array([[7.5, 8.0, 0.0], [8.5, 8.0, 0.0], [7.5, 8.0, 0.0], [8.5, 8.0, 0.0]])
    verdict = Staying(SPACE, target, around_it, solution).judge(Run(x, np.zeros(3, np.int64), False, x, None), 3)
    assert (verdict.outcome.end, verdict.outcome.kept) == (LEFT, False)
    assert verdict.safe.tolist() == [True, True, False, False]
