"""Controllers as files, specifications on cells, refusals in one line, motion between samples."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from pydantic import ValidationError

from simgap.closed_loop import scalar_lookup
from simgap.config.controller import SynthesisSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain
from simgap.geometry import Box, Grid
from simgap.io.controller_file import load_controller, save_controller
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel, Variable
from simgap.specifications.invariance import Invariance
from simgap.specifications.reaching import ReachAvoid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space, cells_meeting, cells_within
from simgap.synthesis.abstraction.intersample import Flow, excursion, flow_of
from simgap.synthesis.controller import Controller, least_effort
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.synthesis.synthesis_plants import pendulum, unicycle

STATES = ("x1", "x2")
DOMAIN = Box([-0.2, -0.5], [0.2, 0.5])


SPACE = Space(STATES, DOMAIN)


def invariance():
    return Invariance(kind="invariance", safe={"x1": (0.0, 0.2)})


def pendulum_problem(cells=(200, 100), gap=None, **more):
    model, inputs = pendulum()
    axes = () if gap is not None else None
    return SynthesisProblem(model, invariance(), SPACE, cells, inputs, gap=gap, gap_axes=axes, **more)


@pytest.fixture(scope="module")
def controller():
    problem = pendulum_problem()
    return Controller(problem.inputs, STATES, ("u",), synthesise(problem), "least_effort", {"seed": 0})


def test_a_controller_reads_back_the_same(controller, tmp_path):
    save_controller(controller, tmp_path / "a.npz")
    save_controller(controller, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    read = load_controller(tmp_path / "a.npz")
    assert np.array_equal(read.solution.mask, controller.solution.mask)
    assert np.array_equal(read.solution.winning, controller.solution.winning)
    assert (read.states, read.input_names, read.rule, read.metadata) == (STATES, ("u",), "least_effort", {"seed": 0})
    assert read.solution.statistics == controller.solution.statistics
    assert load_controller(tmp_path / "a.npz").input([0.1, 0.0]).shape == (1,)
    save_controller(read, tmp_path / "c.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()


def test_the_chosen_input_is_admissible_and_of_least_effort(controller):
    x = DOMAIN.sample(np.random.default_rng(0), 300)
    chosen = controller.lookup(x)
    assert np.array_equal(chosen >= 0, controller.contains(x))
    for point, m in zip(x, chosen, strict=True):
        allowed = controller.inputs(point)
        if m < 0:
            assert len(allowed) == 0
        else:
            assert np.array_equal(controller.input(point), controller.input_set[m])
            assert abs(controller.input_set[m, 0]) == np.abs(allowed).min()


def test_the_middle_rule_takes_the_median(controller):
    middle = Controller(controller.input_set, STATES, ("u",), controller.solution, "middle", {})
    x = [0.1, 0.0]
    allowed = middle.inputs(x)[:, 0]
    assert middle.input(x)[0] == np.sort(allowed)[(len(allowed) - 1) // 2]


def test_effort_orders_by_scaled_squares():
    assert least_effort(np.array([[2.0, 0.0], [0.0, 0.1], [0.0, 0.0], [-1.0, 0.0]])).tolist() == [2, 3, 0, 1]


def test_outside_the_domain_there_is_no_input(controller):
    with pytest.raises(BrokenPromise, match="no input at"):
        controller.input([0.0, -0.5])
    assert not controller.contains([[9.0, 9.0]])[0]
    assert controller.lookup([[9.0, 9.0]]).tolist() == [-1]


def test_outside_the_grid_there_is_nothing_though_its_last_cell_wins():
    """An index of -1 is the last one to an array."""
    value = np.array([3, 2, 1, 0], np.int32)
    grid, ended = Grid(Box([0.0], [4.0]), (4,)), np.ones(4, bool)
    mask = np.full((4, 1), 1, np.uint8)
    own = Controller(
        np.array([[1.0]]), ("x",), ("u",), Solution(grid, ended, mask, ended, value, ended), "least_effort", {}
    )
    at = [[-0.5], [0.5], [3.5], [4.5]]
    assert own.lookup(at).tolist() == [-1, 0, 0, -1]
    assert own.contains(at).tolist() == own.in_target(at).tolist() == [False, True, True, False]
    assert own.value(at).tolist() == [-1, 3, 0, -1]
    find = scalar_lookup(own)
    assert [find(np.array(x), 0)[1] for x in at] == [-1, 0, 0, -1]


def test_a_missing_or_damaged_file_is_one_line(tmp_path):
    with pytest.raises(UserError, match="no such controller"):
        load_controller(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK not really")
    with pytest.raises(UserError, match="not a controller file"):
        load_controller(tmp_path / "bad.npz")
    with pytest.raises(UserError, match="Known rules: least_effort, middle"):
        Controller(np.zeros((1, 1)), (), (), Solution(Grid(DOMAIN, (1, 1)), *[np.zeros((1, 1))] * 3), "random", {})


def test_cells_meet_by_interiors_and_lie_within_closed_boxes():
    grid = Grid(Box([0, 0], [1, 1]), (10, 10))
    box = Box([0.2, 0.3], [0.4, 0.5])
    assert cells_meeting(grid, box).reshape(10, 10).sum() == 4
    assert np.array_equal(cells_meeting(grid, box), cells_within(grid, box))
    assert cells_meeting(grid, Box([0.19, 0.3], [0.4, 0.5])).sum() == 6
    assert cells_within(grid, Box([0.21, 0.3], [0.4, 0.5])).sum() == 2


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"safe": {"x1": (0, 0.3)}}, "sticks out of X"),
        ({"safe": {"x3": (0, 0.3)}}, "no state 'x3'"),
    ],
)
def test_a_wrong_specification_names_key_and_remedy(options, text):
    with pytest.raises(UserError, match=text) as caught:
        Invariance(kind="invariance", **options).region(SPACE)
    assert caught.value.key.startswith("synthesis.specification")
    assert caught.value.remedy


ROBOT = Space(("x", "y", "t"), Box([0, 0, -np.pi], [10, 10, np.pi]), (2,))


def robot(target=((8, 9), (8, 9)), obstacles=(), clearance=0.0, cells=(50, 50, 12), gap=None, **more):
    options = {
        "kind": "reach_avoid",
        "obstacles": [dict(zip("xy", box, strict=True)) for box in obstacles],
        "target": dict(zip("xy", target, strict=True)),
        "clearance": {"x": clearance, "y": clearance},
    }
    inputs = np.array([(v, w) for v in (-0.3, 0.0, 0.3) for w in (-0.5, 0.0, 0.5)])
    specification = ReachAvoid.model_validate(options)
    return SynthesisProblem(unicycle(), specification, ROBOT, cells, inputs, gap, None if gap is None else (), **more)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"obstacles": [((11, 12), (0, 1))]}, "obstacle lies outside the arena"),
        ({"target": ((9, 11), (8, 9))}, "target lies outside the arena"),
        ({"target": ((8, 9), (8, 9)), "obstacles": [((7, 9.5), (7, 9.5))]}, "inside an obstacle"),
        ({"target": ((8.05, 8.25), (8, 9))}, "no cell fits into the target along x.*Cells of 0.1 or less would do"),
        ({"clearance": 6.0}, "clearance leaves no room"),
    ],
)
def test_a_reach_specification_that_cannot_be_met_is_refused(changes, text):
    with pytest.raises(UserError, match=text):
        synthesise(robot(**changes))


def test_clearance_keeps_free_cells_away_from_walls_and_obstacles():
    problem = robot(obstacles=[((4, 5), (0, 6))], clearance=0.3)
    free = problem.specification.free(ROBOT, problem.grid, np.zeros(3)).reshape(problem.grid.cells)
    c = problem.grid.centres().reshape(*problem.grid.cells, 3)
    near_wall = (np.abs(c[..., :2] - 5) + 0.1 > 4.7 + 1e-6).any(-1)
    near_obstacle = (c[..., 0] + 0.1 > 3.7 + 1e-6) & (c[..., 0] - 0.1 < 5.3 - 1e-6) & (c[..., 1] - 0.1 < 6.3 - 1e-6)
    assert np.array_equal(free, ~(near_wall | near_obstacle))


def test_a_latency_with_too_many_cells_and_inputs_is_refused_with_a_remedy():
    with pytest.raises(UserError, match=r"synthesis\.cells: .*too many for a controller with latency.*Use fewer cells"):
        synthesise(robot(cells=(500, 500, 100), latency=1))


def test_the_motion_between_samples_is_bounded():
    x, v, u = sp.symbols("x v u", real=True)
    flow = NominalModel((x, v), (u,), (v, -sp.sin(x) + u), 0.0).enclosure
    inputs = np.array([[-1.0], [1.0]])
    (reach, _), speed = excursion(Flow(flow), Box([-0.1, -0.5], [0.1, 0.5]), inputs, 0.1, np.array([0.0, 0.2]))
    assert np.all(reach >= 0.05 * speed * (1 - 1e-9))
    assert speed[1] == pytest.approx(1.2 + np.sin(0.1 + reach[0]), rel=1e-6)
    assert speed[0] == pytest.approx(0.5 + reach[1], rel=1e-6)


def swinging(extra=""):
    """dq/dt = v, dv/dt = -9 sin q - 2 v + u."""
    q, v, u = (Variable(*own) for own in (("q", "rad"), ("v", "rad/s"), ("u", "N*m")))
    pull = -9 * sp.sin(q.symbol) - 2 * v.symbol + u.symbol + (sp.Abs(v.symbol) if extra else 0)
    return SymbolicModel((q, v), (u,), {}, (v.symbol, pull))


def test_a_path_leaves_walls_that_hold_its_samples_by_less_than_it_strays_from_them():
    """Paths integrated finely, under a disturbance of the stated size, whose ends are both in the box: all of them
    stay within what is said, and one comes near it. Half a step at the largest speed would be far more."""
    region, inputs = Box([-0.3, -0.5], [0.3, 0.5]), np.linspace(-6, 6, 25)[:, None]
    tau, added = 0.1, np.array([0.0, 0.4])
    (near, walls), _ = excursion(flow_of(swinging()), region, inputs, tau, added)
    rng, steps = np.random.default_rng(0), 400
    x = rng.uniform(region.lo, region.hi, (20_000, 2))
    x[:, 1] = rng.choice([-0.5, 0.5], len(x)) * rng.uniform(0.97, 1.0, len(x))
    start, u, d = x.copy(), rng.choice(inputs[:, 0], len(x)), 0.4 * rng.choice([-1.0, 1.0], (2, len(x)))
    out, path = np.zeros_like(x), []
    for k in range(steps):
        v = x[:, 1] + 0.5 * tau / steps * (-9 * np.sin(x[:, 0]) - 2 * x[:, 1] + u + d[2 * k // steps])
        x = x + tau / steps * np.stack([v, -9 * np.sin(x[:, 0]) - 2 * v + u + d[2 * k // steps]], axis=1)
        out = np.maximum(out, np.maximum(x - region.hi, region.lo - x))
        path.append(x)
    held = np.all((x >= region.lo) & (x <= region.hi), axis=1)
    assert held.sum() > 500
    between = np.array(path)[:, held]
    nearest = np.minimum(np.abs(between - start[held]), np.abs(between - x[held]))
    farthest = nearest.max(axis=(0, 1))
    assert np.all(out[held].max(axis=0) <= walls)
    assert np.all(farthest <= near)
    assert np.all(walls < 0.5 * near)
    assert walls[1] < 0.1 * near[1]
    assert out[held, 1].max() > 0.1 * walls[1]


def test_a_model_with_a_kink_is_bounded_by_its_rates_alone():
    region, inputs = Box([-0.3, -0.5], [0.3, 0.5]), np.array([[0.0]])
    near, walls = excursion(flow_of(swinging("kinked")), region, inputs, 0.1)[0]
    assert np.array_equal(near, walls)


def test_a_motion_without_bound_is_a_broken_promise():
    x, u = sp.symbols("x u", real=True)
    flow = NominalModel((x,), (u,), (x**3 + u,), 0.0).enclosure
    with pytest.raises(BrokenPromise, match="no bound"):
        excursion(Flow(flow), Box([-9.0], [9.0]), np.zeros((1, 1)), 1.0)


def test_the_section_refuses_unknown_keys_and_upside_down_boxes():
    good = {"cells": [10, 10], "specification": {"kind": "invariance", "safe": {"x1": [0, 1]}}}
    assert SynthesisSection.model_validate(good).cells == (10, 10)
    for bad in (
        good | {"cell": 3},
        good | {"cells": [0, 10]},
        good | {"specification": {"kind": "stay"}},
        good | {"specification": {"kind": "invariance", "safe": {"x1": [1, 0]}}},
        good | {"specification": {"kind": "reach_avoid", "safe": {}}},
        good | {"specification": {"kind": "reach_avoid", "target": {"x": [0, 1]}, "clearance": {"x": -1}}},
    ):
        with pytest.raises(ValidationError):
            SynthesisSection.model_validate(bad)


def test_an_error_of_the_heading_costs_the_layers_at_the_seam_no_more_than_others():
    """A gap bound that knows no heading beyond +-pi left nothing there to win."""
    inputs = np.array([(v, w) for v in (0.0, 0.3) for w in (-0.5, 0.0, 0.5)])
    domain = GapDomain(("x", "y", "t"), ("v", "w"), ROBOT.box, inputs, (0, 1), (2,))
    gap = BodyFrameGap(domain, (), np.full((1, 6, 3), -0.02), np.full((1, 6, 3), 0.02))
    exact = robot(target=((4, 6), (4, 6)), cells=(60, 60, 24), error=np.array([0.0, 0.0, 0.03]))
    problem = replace(exact, inputs=inputs, gap=gap.kernel(), gap_axes=[2])
    wins = synthesise(problem).winning.reshape(problem.grid.cells).mean(axis=(0, 1))
    assert wins.min() > 0.5
    assert wins[[0, -1]].min() > 0.9 * wins[1:-1].min()
