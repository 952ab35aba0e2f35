"""Where searches begin: beside switching surfaces, at the worst recorded histories; and why there may be no margins."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from simgap.attack.worst_step import GapProblem, search_points, worst_histories
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.sampling.points import step_columns
from simgap.geometry import Box, Grid
from simgap.plants.context import Context
from simgap.simulators.body_samples import REST, BodySamples
from simgap.specifications.solution import Solution
from simgap.synthesis.margins import margins_of

FRICTION = [{"name": "coulomb_friction", "on": "hinge", "parameters": {"F_c": 0.01}}]


def domain_of(context):
    return GapDomain(tuple(context.states), tuple(context.inputs), context.box, context.input_set)


def asked(context, jump):
    """A simulator with a gap of `jump` at rest alone, and a bound that lacks it."""

    def rollouts(x, u):
        return context.plant.sampled.step(x, u) + np.where(x[:, 1:] == 0.0, jump, 0.0) * np.array([0.0, 1.0])

    def bounds(x, u):
        return np.full(x.shape, -1e-3), np.full(x.shape, 1e-3)

    simulator = SimpleNamespace(spread=lambda x, u: (rollouts(x, u),) * 2)
    return GapProblem.of(context, simulator, SimpleNamespace(bounds=bounds, domain=domain_of(context)))


def test_a_jump_at_rest_is_found_where_a_case_switches_there(vary):
    """Rest lies inside X, off the middle, so that neither its border nor its centre has it."""
    own = {"simulator.effects": FRICTION, "domain.X.x2": [-0.3, 0.5]}
    context = Context.load(vary("pendulum", own))
    q = asked(context, 0.1)
    assert set(itertools.product(*zip(q.box.lo.tolist(), q.box.hi.tolist(), strict=True))) <= {
        tuple(x) for x in q.places.tolist()
    }
    assert (q.places[:, 1] == 0.0).sum() > 2
    assert (np.abs(q.places[:, 1]) < 1e-8).sum() == 3 * (q.places[:, 1] == 0.0).sum()
    assert len(q.places) < 2500
    found = search_points(q, 4000, np.random.default_rng(0), np.empty((0, 2)), np.empty(0, np.int64))
    assert found.violations > 0


def test_what_is_known_is_not_crowded_out_by_places():
    """Half of what goes to looking at beginnings is for the worst known steps, in their order."""
    seen = []

    def successors(x, u):
        seen.append(x)
        return x, x

    box, inputs = Box([0.0], [1.0]), np.zeros((1, 1))
    places = np.linspace(0.0, 0.4, 1000)[:, None]

    def bounds(x, u):
        return np.full(x.shape, -1.0), np.full(x.shape, 1.0)

    q = GapProblem(successors, lambda x, u: x, bounds, box, inputs, places=places)
    known = np.linspace(0.6, 1.0, 50)[:, None]
    search_points(q, 100, np.random.default_rng(0), known, np.zeros(50, np.int64))
    x = seen[0]
    assert np.array_equal(x[:15], known[:15])
    assert (x[15:30] <= 0.4).all()
    assert sum(map(len, seen)) == 100


@pytest.fixture
def robot(root, vary):
    own = {"simulator.urdf": str(root / "configs/models/turtlebot.urdf")}
    return Context.load(vary("turtlebot", own))


def sequences(count, size, inputs, rng):
    """Random sequences from rest, one after the other; nothing moves."""
    m = rng.integers(0, inputs, (count, size))
    before = np.concatenate([np.full((count, 1), REST), m[:, :-1]], axis=1)
    n = count * size
    return BodySamples(m.ravel(), np.zeros((n, 3)), np.zeros((n, 4)), before.ravel())


def test_histories_are_those_that_were_run_whatever_the_length_of_their_sequences(robot):
    """Fresh sequences of five among the shipped case's chains of 500."""
    count, rng = len(robot.input_set), np.random.default_rng(1)
    assert robot.case.hidden_state.chain_length > 5
    own = sequences(40, 5, count, rng)
    gap = BodyFrameGap(domain_of(robot), (), -np.ones((1, count, 3)), np.ones((1, count, 3)))
    table = step_columns(robot.case, robot.input_set, own)
    found = worst_histories(robot, gap, np.zeros((count, 3)), [table], 4)
    ran = {tuple(row) for row in own.m.reshape(40, 5).tolist()}
    assert {tuple(row) for row in found.tolist()} == ran
    pairs = worst_histories(robot, gap, np.zeros((count, 3)), [table], 1)
    inside = {(row[k], row[k + 1]) for row in ran for k in range(4)}
    assert {tuple(row) for row in pairs.tolist()} <= inside
    assert len(pairs) == 4 * 40


def test_a_step_is_held_against_the_class_of_what_was_recorded_before_it(robot):
    """The bound is narrow after one class alone, that of rest, so that its steps are the worst."""
    count, rng = len(robot.input_set), np.random.default_rng(2)
    kind = np.arange(count) % 2
    wide, narrow = np.ones((count, 3)), np.full((count, 3), 0.1)
    classes = PreviousClasses(kind, 1)
    upper = np.stack([wide, narrow])
    gap = BodyFrameGap(domain_of(robot), (), -upper, upper, classes=classes)
    own = sequences(60, 5, count, rng)
    moved = BodySamples(own.m, own.final + 0.05, own.extent, own.previous)
    table = step_columns(robot.case, robot.input_set, moved)
    found = worst_histories(robot, gap, np.zeros((count, 3)), [table], 1)
    after = kind[found[:, 0]]
    assert (np.diff(after) <= 0).all()  # after the narrow class first
    first = worst_histories(robot, gap, np.zeros((count, 3)), [table], 0)
    narrow_first = int((classes.after(moved.previous) == 1).sum())
    taken = min(narrow_first, 200)
    last = {tuple(row) for row in first[:taken].tolist()}
    assert last <= {(m,) for m in moved.m[classes.after(moved.previous) == 1].tolist()}


def test_margins_that_cannot_be_had_say_why(vary, monkeypatch):
    """An older controller file, and tables that would outgrow memory."""
    context = Context.load(vary("pendulum", {"sensing": {"error": {"x1": 0.001, "x2": 0.01}, "latency": 1}}))
    grid, count = Grid(context.box, (4, 4)), len(context.input_set)
    every, mask = np.ones(grid.size, np.bool_), np.full((grid.size * count, 4), 255, np.uint8)
    solution = Solution(grid, every, mask, every, memory=count, late=True)
    assert "run the synthesis again" in margins_of(context, None, solution)
    monkeypatch.setattr("simgap.synthesis.margins.LARGEST_TABLES", 1000)
    assert "25 sets of cells reaches would take 0.0 GB" in margins_of(context, None, solution)
