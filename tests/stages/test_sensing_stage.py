"""Sensing from the case file to the closed loop: bounded error and a sample of latency, in the engine."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from simgap.cli import main
from simgap.closed_loop import Sensing, closed_loop
from simgap.config.gap import GapSection, LipschitzSection
from simgap.config.load import case_content
from simgap.gap.bases import Expressions
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.points import product
from simgap.geometry import Box, Grid
from simgap.io.controller_file import load_controller
from simgap.io.gap_file import load_gap
from simgap.io.results import read_json, write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import synthesis, validation
from simgap.stages.validation import draw_starts
from simgap.synthesis.margins import margins_of
from tests.gap.fit_in_memory import GapSamples, fit_gap
from tests.synthesis.test_margins import check


@pytest.fixture
def sensed(root, tmp_path):
    """The shipped case on fewer cells, and a bound fitted to a coarse grid."""
    content = case_content(root / "configs/cases/pendulum_sensing.yaml")
    content["plant"]["urdf"] = str(root / "configs/models/pendulum.urdf")
    content["synthesis"]["cells"] = [400, 200]
    content["domain"]["U"]["u"]["step"] = 0.2
    content["validation"] = {"starts": 20, "steps": 200, "seed": 2}
    path = tmp_path / "pendulum_sensing.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def bound(path, out):
    context = Context.load(path)
    grid = Grid.covering(context.box, 0.03)
    x, u = product(grid.centres(), context.input_set)
    ((following, _),) = run_in_processes(roll_out, [(context.case, context.folder, x, u)])
    d = following - context.plant.sampled.step(x, u)
    names = tuple(context.states), tuple(context.inputs)
    samples = GapSamples(grid, context.input_set, d.reshape(grid.size, -1, 2), *names)
    terms = ("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
    settings = GapSection(basis=Expressions(terms=terms), lipschitz=LipschitzSection(extreme_value=False))
    record = provenance("gap", context.case, context.folder)
    write_json(out, fit_gap(samples, settings).function.to_json() | {"provenance": record})


def test_the_promise_holds_for_measurements_a_sample_late(sensed, tmp_path):
    found, made, figures = (tmp_path / n for n in ("gap.json", "controller.npz", "synthesis.json"))
    bound(sensed, found)
    synthesis.run(sensed, found, made, figures, 1)
    assert read_json(figures)["winning_fraction"] > 0.8
    validation.run(sensed, made, made, found, tmp_path / "v.json", tmp_path / "traces.parquet", 1)
    tally = read_json(tmp_path / "v.json")["controllers"]["gap"]["simulator"]
    assert tally["runs_that_violated_it"] == tally["steps_outside_gamma"] == 0
    assert tally["steps"] == 20 * 200
    margins_are_those_of_the_definition(sensed, found, load_controller(made).solution)


def margins_are_those_of_the_definition(case, found, solution):
    """Of cells of the true state, while the first input acts, over all measurements of the error box."""
    context = Context.load(case)
    gap = load_gap(found, context).function
    margins = margins_of(context, gap, solution)
    assert margins.only == "where the first input, u = 0, acts"
    assert np.array_equal(margins.factor >= 1.0, solution.winning)
    assert (margins.factor[solution.winning] >= 1.0).all()
    inner, reach = slice(3, -3), (3, 3)  # .001 rad are two cells of .0005 and a face, .01 rad/s two of .005
    cells, larger = (400, 200), solution.grid.cells
    assert larger == (406, 206)
    grid = Grid(Box([0.0, -0.5], [0.2, 0.5]), cells)
    own = replace(
        margins,
        factor=margins.factor.reshape(larger)[inner, inner].ravel(),
        extra=margins.extra.reshape(*larger, 2)[inner, inner].reshape(-1, 2),
    )
    count = len(context.input_set)
    may = np.unpackbits(solution.acting, axis=1, count=count, bitorder="little")
    may = may.reshape(*larger, count)[inner, inner].reshape(-1, count).astype(bool)
    mask = solution.mask.reshape(solution.grid.size, count, -1)[:, solution.first]
    some = np.random.default_rng(4).choice(np.flatnonzero(may[:, solution.first]), 12)
    about = context.plant.sampled, grid, context.input_set, gap.kernel(), may, mask
    check(*about, own, some, 2, np.arange(count), solution.first, reach)


@pytest.mark.parametrize(
    ("first", "says"),
    [({"u": 0.05}, "sensing.first_input: {'u': 0.05} is not in U"), ({"v": 0.2}, "the first input names v")],
)
def test_a_first_input_that_does_not_exist_is_refused_in_one_line(sensed, tmp_path, capsys, first, says):
    content = yaml.safe_load(sensed.read_text())
    content["sensing"]["first_input"] = first
    sensed.write_text(yaml.safe_dump(content))
    files = ["--out", str(tmp_path / "c.npz"), "--summary", str(tmp_path / "s.json"), "--log", str(tmp_path / "l")]
    with pytest.raises(SystemExit) as caught:
        main(["synthesis", str(sensed), *files])
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert str(sensed) in line
    assert says in line


def test_sensing_that_leaves_nothing_says_so(sensed, tmp_path, capsys):
    content = yaml.safe_load(sensed.read_text())
    content["sensing"] = {"error": {"x1": 0.15, "x2": 0.4}, "latency": 1}
    sensed.write_text(yaml.safe_dump(content))
    files = ["--out", str(tmp_path / "c.npz"), "--summary", str(tmp_path / "s.json"), "--log", str(tmp_path / "l")]
    with pytest.raises(SystemExit) as caught:
        main(["synthesis", str(sensed), *files])
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "measurement error" in line
    assert "latency of 1 sample" in line
    assert not (tmp_path / "c.npz").exists()
    said = json.loads((tmp_path / "s.json").read_text())  # why, in figures
    assert said["winning_cells"] == 0
    assert said["empty"]["axes"]


class Model:
    """The nominal model as a plant."""

    def __init__(self, step):
        self.step = step

    def reset(self, x):
        self.x = x

    def advance(self, u):
        self.x = self.step(self.x[None], u[None])[0]
        return self.x


def test_the_robot_arrives_by_measurements_a_sample_late(root, tmp_path):
    """The shipped case on fewer cells and without its gap, from certified starts, corners of the error box included."""
    content = case_content(root / "configs/cases/turtlebot_sensing.yaml")
    content["simulator"]["urdf"] = str(root / "configs/models/turtlebot.urdf")
    content["synthesis"] |= {"cells": [60, 60, 48], "nominal_between_samples": True}
    content["sensing"]["error"] = {"x": 0.015, "y": 0.015, "theta": 0.015}
    path, made = tmp_path / "robot.yaml", tmp_path / "c.npz"
    path.write_text(yaml.safe_dump(content))
    synthesis.run(path, None, made, tmp_path / "s.json", 1)
    figures = read_json(tmp_path / "s.json")
    assert figures["between_samples_by"] == "swept boxes"  # the heading is measured with an error
    assert figures["winning_fraction"] > 0.3
    controller, context = load_controller(made), Context.load(path)
    assert (controller.late, controller.memory) == (True, 15)
    assert controller.input_set[controller.first].tolist() == [0.0, 0.0]
    space, rng = Space.of(context.case), np.random.default_rng(4)
    monitor = specification_of(context.case).monitor(space, controller.solution)
    sensing, step = Sensing(np.full(3, 0.015), 1), context.plant.sampled.step
    for x in draw_starts(controller, 60, 2):
        run = closed_loop(Model(step), controller, x, 100, sensing, rng, monitor, sensing.measure(x, rng))
        verdict = monitor.judge(run, 100)
        assert verdict.outcome.kept, verdict.outcome
        assert verdict.outcome.figures["climbs"] == 0
        assert run.inputs[0] == controller.first
    solution, count = controller.solution, len(context.input_set)
    names = tuple(context.states), tuple(context.inputs)
    domain = GapDomain(*names, context.box, context.input_set, (0, 1, 2), context.periodic)
    gap = BodyFrameGap(domain, (), np.zeros((1, count, 3)), np.zeros((1, count, 3)))
    margins, sets = margins_of(context, gap, solution), solution.value.reshape(-1, count) >= 0
    assert margins.only == "where the first input, v = 0, w = 0, acts"
    moving = solution.value.reshape(-1, count)[:, solution.first] > 0
    assert np.array_equal(margins.factor >= 1.0, moving)
    mask = solution.mask.reshape(solution.grid.size, count, -1)[:, solution.first]
    about = context.plant.sampled, solution.grid, context.input_set, gap.kernel(), sets, mask
    some = rng.choice(np.flatnonzero(moving), 10)
    check(*about, margins, some, 3, np.arange(count), solution.first, None, sensing.error)
