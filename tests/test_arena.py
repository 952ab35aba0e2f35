"""Distances checked by hand, and how runs end on a robot that does exactly as it is told."""

import numpy as np
import pytest

from simgap.arena import COLLIDED, LATE, REACHED, STUCK, Arena, drive, wrapped

ARENA = Arena(np.array([[4.0, 5.0, 0.0, 6.0]]), np.array([0.0, 10.0, 0.0, 10.0]), 0.2)


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((3.0, 3.0), 0.8),
        ((0.3, 8.0), 0.1),
        ((8.0, 10.0), -0.2),
        ((2.0, 9.0), 0.8),
        ((4.1, 3.0), -0.3),
        ((1.0, 10.0), -0.2),
    ],
)
def test_clearance(point, distance):
    assert ARENA.clearance(np.array([point])) == pytest.approx(distance)


def test_clearance_to_a_corner_is_euclidean_and_a_way_takes_its_worst_point():
    assert ARENA.clearance(np.array([[5.3, 6.4]])) == pytest.approx(0.5 - 0.2)
    assert ARENA.clearance(np.array([[8.0, 5.0], [5.3, 6.4], [7.0, 7.0]])) == pytest.approx(0.3)


class Cart:
    """Moves by u along x at once, with five poses on the way."""

    def reset(self, x):
        self.x = x.copy()

    def advance(self, u):
        share = np.linspace(0.2, 1.0, 5)[:, None]
        self.path = self.x + share * np.array([u[0], 0.0, 0.0])
        self.x = self.path[-1].copy()
        return self.x


class Always:
    input_set = np.array([[0.5], [-0.5]])

    def __init__(self, chosen):
        self.chosen = chosen

    def lookup(self, x, pending=0):
        return np.array([self.chosen(x[0])])


def go(chosen, value, start=1.0, steps=20):
    return drive(Cart(), Always(chosen), value, ARENA, np.array([start, 3.0, 0.0]), steps)


def test_ends():
    right, left = (lambda x: 0), (lambda x: 1)
    assert go(right, lambda x: max(0, int(np.ceil((3.0 - x[0]) / 0.5)))).end == REACHED
    hit = go(right, lambda x: 99 - len(x))
    assert hit.end == COLLIDED
    assert hit.clearance < 0
    assert go(left, lambda x: 5, steps=1).end == LATE
    assert go(lambda x: -1, lambda x: 5).end == STUCK


def test_a_collision_between_samples_is_seen():
    thin = Arena(np.array([[3.05, 3.1, 0.0, 6.0]]), ARENA.walls, 0.01)
    run = drive(Cart(), Always(lambda x: 0), lambda x: 7, thin, np.array([2.8, 3.0, 0.0]), 1)
    assert run.end == COLLIDED  # 2.8 and 3.3 are clear, 3.1 is not


def test_climbs_count_steps_after_which_the_value_had_not_fallen():
    values = iter([5, 4, 4, 3, -1, 2])
    run = go(lambda x: 0 if x[0] < 2 else 1, lambda x: next(values), steps=5)
    assert run.climbs == 3  # 4 -> 4, 3 -> -1, -1 -> 2


def test_wrapping_moves_state_and_successor_alike():
    x, following = np.array([[1.0, 7.0], [1.0, -4.0]]), np.array([[2.0, 7.5], [2.0, -4.5]])
    a, b = wrapped(x, following, 1, -np.pi, np.pi)
    assert np.all((a[:, 1] >= -np.pi) & (a[:, 1] < np.pi))
    assert np.allclose(b - a, following - x)
