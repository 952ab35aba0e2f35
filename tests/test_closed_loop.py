"""The loop against hand-made plants and policies."""

import numpy as np
import pytest

from simgap.closed_loop import Sensing, batch_loop, closed_loop, scalar_lookup, split_by_run, steps_of, tallied
from simgap.geometry import Box, Grid
from simgap.specifications.base import Run
from simgap.specifications.invariance import Inside

INPUTS = np.array([[-1.0], [0.0], [1.0]])


class Integrator:
    """x+ = x + 0.1 u."""

    def reset(self, x):
        self.x = np.array(x)

    def advance(self, u):
        self.x = self.x + 0.1 * u
        return self.x


class Table:
    """A grid policy like the saved controller's."""

    def __init__(self, choice, memory=1, periodic=(), first=0):
        self.grid = Grid(Box([-1.0], [1.0]), [len(choice) // memory], periodic)
        self.choice, self.memory, self.input_set = np.array(choice), memory, INPUTS
        self.first, self.late = first, memory > 1

    def lookup(self, x, pending):
        cells = self.grid.index(x)
        return np.where(cells >= 0, self.choice[cells * self.memory + pending], -1)


NEVER, NEAR = Inside(Box([-9.0], [9.0])), Inside(Box([-0.95], [0.95]))


EXACT = Sensing(np.zeros(1))


def test_a_run_follows_the_policy_and_stops_where_it_has_no_input():
    policy = Table([-1, 2, 2, 2])  # to the right, no input in the leftmost quarter
    rng = np.random.default_rng(0)
    run = closed_loop(Integrator(), policy, np.array([0.05]), 5, EXACT, rng, NEVER)
    assert np.allclose(run.x[:, 0], 0.05 + 0.1 * np.arange(6))
    assert run.inputs.tolist() == [2] * 5
    assert not run.stuck
    assert closed_loop(Integrator(), policy, np.array([-0.9]), 5, EXACT, rng, NEVER).stuck


def test_a_run_stops_where_it_is_told():
    run = closed_loop(
        Integrator(), Table([2, 2]), np.array([0.0]), 50, EXACT, np.random.default_rng(0), Inside(Box([-1.0], [0.35]))
    )
    assert len(run.inputs) == 4
    assert run.x[-1, 0] > 0.35


def test_latency_applies_the_decision_one_sample_later():
    # rows of a cell: the three inputs that may be pending; input 1 acts until the first decision does
    policy = Table([0, 2, 0, 0, 2, 0], memory=3, first=1)
    run = closed_loop(
        Integrator(), policy, np.array([0.0]), 3, Sensing(np.zeros(1), 1), np.random.default_rng(0), NEVER
    )
    assert run.inputs.tolist() == [1, 2, 0]
    assert run.memory.tolist() == [1, 2, 0, 0]


def test_measurements_stay_within_the_error_and_reach_its_corners():
    sensing = Sensing(np.array([0.01, 0.2]))
    rng = np.random.default_rng(1)
    e = np.array([sensing.measure(np.zeros(2), rng) for _ in range(500)])
    assert np.all(np.abs(e) <= sensing.error)
    assert np.isclose(np.abs(e), sensing.error).all(axis=1).mean() > 0.3


@pytest.mark.parametrize("periodic", [(), (0,)])
def test_the_scalar_lookup_is_the_grids_own_on_every_bit(periodic):
    rng = np.random.default_rng(2)
    policy = Table(rng.integers(-1, 3, 37), periodic=periodic)
    edges = policy.grid.box.lo + 2.0 * policy.grid.h * np.arange(38)
    points = np.concatenate([edges, np.nextafter(edges, 9), np.nextafter(edges, -9), rng.uniform(-1.2, 1.2, 500)])
    find = scalar_lookup(policy)
    assert [find(np.array([p]), 0)[1] for p in points] == policy.lookup(points[:, None], 0).tolist()


def test_the_batch_is_the_loop():
    policy = Table([2, 2, 2, 1, 0, 0])
    starts = np.random.default_rng(3).uniform(-1, 1, (40, 1))
    runs = batch_loop(lambda x, u: x + 0.1 * u, policy, starts, 30, NEAR)
    for start, run in zip(starts, runs, strict=True):
        alone = closed_loop(Integrator(), policy, start, 30, EXACT, np.random.default_rng(0), NEAR)
        assert np.array_equal(run.x, alone.x)
        assert np.array_equal(run.inputs, alone.inputs)


def test_the_batch_is_the_loop_with_latency_too():
    rng = np.random.default_rng(4)
    policy = Table(rng.integers(0, 3, 3 * 6), memory=3, first=2)
    starts = rng.uniform(-1, 1, (30, 1))
    runs = batch_loop(lambda x, u: x + 0.1 * u, policy, starts, 20, NEAR)
    for start, run in zip(starts, runs, strict=True):
        late = Sensing(np.zeros(1), 1)
        alone = closed_loop(Integrator(), policy, start, 20, late, rng, NEAR)
        assert np.array_equal(run.memory, alone.memory)
        assert np.array_equal(run.x, alone.x)
        assert np.array_equal(run.inputs, alone.inputs)


def made(x, stuck=False):
    return Run(x, np.zeros(len(x) - 1, dtype=np.int64), stuck, x)


def test_counting():
    inside = Inside(Box([-1.0], [1.0]))
    good, out = made(np.zeros((4, 1))), made(np.array([[0.0], [2.0]]))
    judged = [inside.judge(good, 3), inside.judge(out, 3), inside.judge(made(good.x, stuck=True), 9)]
    judged.append(inside.judge(good, 9))
    assert [(v.outcome.end, v.outcome.kept) for v in judged] == [
        ("stayed", True), ("left the safe set", False), ("no admissible input", False), ("ended early", False),
    ]  # fmt: skip
    assert judged[1].safe.tolist() == [True, False]
    x, u, following = steps_of([good, out], INPUTS)
    assert (len(x), len(u), following[-1, 0]) == (4, 4, 2.0)
    assert split_by_run([True, False, True, True], [good, out]) == [2, 1]
    content = tallied([judged[0].outcome, judged[1].outcome], 1)
    assert content["runs_that_violated_it"] == 1
    assert content["steps_outside_gamma"] == 1
    assert content["median_steps_until_violation"] == 1.0
