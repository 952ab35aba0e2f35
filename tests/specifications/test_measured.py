"""Reaching with a bounded measurement error: the true state keeps clear and arrives, whatever is measured."""

import itertools

import numpy as np
import pytest
import sympy as sp

from simgap.closed_loop import Sensing, closed_loop, strays
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.io.controller_file import load_controller, save_controller
from simgap.model.sampled import NominalModel
from simgap.specifications.invariance import Invariance
from simgap.specifications.reaching import ReachAndStay, ReachAvoid
from simgap.specifications.space import Space
from simgap.specifications.task import Task
from simgap.synthesis.controller import Controller
from simgap.synthesis.synthesise import SynthesisProblem, synthesise

SPACE = Space(("x", "y"), Box([0.0, 0.0], [4.0, 3.0]))
ERROR = np.array([0.04, 0.03])
WIDE = {"x": (2.4, 3.6), "y": (0.2, 1.4)}
SAFE = {"x": (0.5, 3.5)}
OBSTACLE, TARGET = {"x": (1.5, 2.0), "y": (0.0, 2.0)}, {"x": (3.0, 3.6), "y": (0.3, 0.9)}


class Truth:
    """x+ = x + 0.2 u, exactly."""

    def reset(self, x):
        self.x = x.copy()

    def advance(self, u):
        self.x = self.x + 0.2 * u
        return self.x


@pytest.fixture(scope="module")
def mover():
    x, y, u, v = sp.symbols("x y u v", real=True)
    return NominalModel((x, y), (u, v), (x + u / 5, y + v / 5), 1.0)


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize(("kind", "name"), [(ReachAvoid, "reach_avoid"), (ReachAndStay, "reach_and_stay")])
def test_no_true_state_is_where_it_must_not_be(mover, kind, name, latency, tmp_path):
    inputs = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=2)))
    asked = kind(kind=name, obstacles=(OBSTACLE,), target=WIDE if latency else TARGET)
    cells = (87, 66) if latency else (80, 60)
    solution = synthesise(SynthesisProblem(mover, asked, SPACE, cells, inputs, error=ERROR, latency=latency))
    made = Controller(inputs, SPACE.states, ("u", "v"), solution, "least_effort", {"stage": "synthesis"})
    save_controller(made, tmp_path / "controller.npz")
    controller = load_controller(tmp_path / "controller.npz")
    assert np.array_equal(controller.choice, made.choice)
    assert controller.input_set[controller.first].tolist() == [0.0, 0.0] if latency else controller.memory == 1
    monitor, rng = asked.monitor(SPACE, solution), np.random.default_rng(1)
    starts = SPACE.box.sample(rng, 400)
    starts = starts[controller.contains(starts)]
    assert len(starts) > 150
    near = 0.0
    for start in starts:
        measured = start + ERROR * rng.choice([-1.0, 1.0], 2)
        run = closed_loop(Truth(), controller, start, 60, Sensing(ERROR, latency), rng, monitor, measured)
        verdict = monitor.judge(run, 60)
        assert verdict.outcome.kept, verdict.outcome
        assert verdict.outcome.figures["climbs"] == 0
        assert not latency or run.inputs[:1].tolist() in ([], [controller.first])
        near = max(near, float(np.abs(run.measured - run.x).max()))
    assert near == pytest.approx(0.04)


TASKS = ("G F pickup & G F dropoff & G !hole", "!hole U (pickup & F dropoff)", "G !hole & F G pickup")


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize("formula", TASKS)
def test_true_states_keep_the_task_whatever_is_measured(mover, formula, latency):
    inputs = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=2)))
    places = {"pickup": WIDE, "dropoff": ["x <= 0.8", {"y": (2.4, 3.0)}], "hole": "(x - 2)^2 + (y - 2)^2 <= 0.16"}
    asked = Task(kind="task", formula=formula, regions=places, obstacles=(OBSTACLE | {"y": (0.0, 1.0)},))
    solution = synthesise(SynthesisProblem(mover, asked, SPACE, (87, 66), inputs, error=ERROR, latency=latency))
    controller = Controller(inputs, SPACE.states, ("u", "v"), solution, "least_effort", {"stage": "synthesis"})
    monitor, rng = asked.monitor(SPACE, solution), np.random.default_rng(5)
    starts = SPACE.box.sample(rng, 200)
    starts = starts[controller.contains(starts)]
    assert len(starts) > 60
    rounds = []
    for start in starts:
        measured = start + ERROR * rng.choice([-1.0, 1.0], 2)
        run = closed_loop(Truth(), controller, start, 150, Sensing(ERROR, latency), rng, monitor, measured)
        verdict = monitor.judge(run, 150)
        assert verdict.outcome.kept, verdict.outcome
        assert strays(solution, run) == 0
        hole = np.hypot(*(verdict.run.x - 2.0).T) <= 0.4
        assert not hole.any()
        rounds.append(verdict.outcome.figures["rounds"])
    assert min(rounds) >= (1 if "U" in formula else 2)


@pytest.mark.parametrize("kind", ["reach_avoid", "invariance"])
def test_a_first_question_is_answered_at_every_certified_start(mover, kind):
    inputs = np.array(list(itertools.product([-1.0, 1.0, 0.0], repeat=2)))  # number 0 is not rest
    asked = ReachAvoid(kind=kind, target=TARGET) if kind == "reach_avoid" else Invariance(kind=kind, safe=SAFE)
    solution = synthesise(SynthesisProblem(mover, asked, SPACE, (87, 66), inputs, error=ERROR, latency=1, first=5))
    controller = Controller(inputs, SPACE.states, ("u", "v"), solution, "least_effort", {})
    rng = np.random.default_rng(3)
    starts = SPACE.box.sample(rng, 2000)
    starts = starts[controller.contains(starts)]
    assert len(starts) > 600
    for start in starts:
        measured = start + ERROR * rng.choice([-1.0, 1.0], 2)
        if controller.in_target(measured)[0]:
            continue
        chosen = controller.input(measured)  # raises where there is none
        assert chosen.tolist() in controller.inputs(measured, 5).tolist()
        assert chosen.tolist() == controller.input(measured, 5).tolist()


def test_a_target_smaller_than_the_error_is_refused(mover):
    small = ReachAvoid(kind="reach_avoid", target={"x": (3.0, 3.07), "y": (0.3, 0.9)})
    with pytest.raises(UserError, match="The measurement error is as large as the target"):
        synthesise(SynthesisProblem(mover, small, SPACE, (80, 60), np.zeros((1, 2)), error=ERROR))
