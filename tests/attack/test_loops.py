"""Closed-loop attacks against planted faults that the controller's own choice from random starts does not show."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from simgap.attack.campaign import (
    LENGTH,
    ControlLaw,
    Danger,
    Opponent,
    Scene,
    WorstDisturbance,
    WorstStarts,
    campaign,
    each_once,
)
from simgap.closed_loop import Judge, batch_loop
from simgap.geometry import Box, Grid
from simgap.specifications.invariance import Inside
from simgap.specifications.reaching import ReachAndStay
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.stages.validation import draw_starts
from simgap.synthesis.abstraction.cells import nominal_abstraction
from simgap.synthesis.controller import Controller
from simgap.synthesis.games.game import NodeGame
from simgap.synthesis.games.invariance import invariance
from tests.synthesis import synthesis_plants as plants

BOX = Box([0.0, -0.5], [0.2, 0.5])
SPACE = Space(("x1", "x2"), BOX)
GAMMA = np.array([1e-5, 1e-3])
STEPS = 4000


@pytest.fixture(scope="module")
def problem():
    model, inputs = plants.pendulum()
    grid = Grid(BOX, (200, 100))
    abstraction = nominal_abstraction(model, grid, inputs, plants.constant_gap(*GAMMA))
    won = invariance(abstraction)
    return model, inputs, abstraction, Solution(grid, won.winning, won.mask, np.ones(grid.size, bool))


def attack(problem, solution, gamma=GAMMA, error=(0.0, 0.0), seed=0, monitor=None, holds=False):
    """The campaign against f + [-gamma, gamma]."""
    model, inputs, _, _ = problem
    rng, monitor = np.random.default_rng(seed), monitor or Inside(BOX)
    law, danger = ControlLaw(solution, inputs, np.array(error)), Danger.of(solution)

    def bounds(x, u, before):
        return np.broadcast_to(-gamma, x.shape), np.broadcast_to(gamma, x.shape)

    plant = WorstDisturbance(model.step, bounds, danger, monitor, rng)
    judge = Judge(SPACE, monitor, 200, inputs, model, None, solution)
    scene = Scene(lambda x, m, before: model.step(x, inputs[m]), None, danger, inputs, solution.late)
    worst = WorstStarts(solution)
    return campaign(Opponent(plant, judge, False, 32, holds), law, scene, lambda n: worst.draw(n, rng), STEPS, rng)


def at_random(problem, solution, gamma=GAMMA, seed=0):
    """As many steps of the controller's own choice from random starts under random disturbances: violations."""
    model, inputs, _, _ = problem
    own = Controller(inputs, ("x1", "x2"), ("u",), solution, "least_effort", {})
    rng, monitor = np.random.default_rng(seed), Inside(BOX)

    def step(x, u):
        return model.step(x, u) + gamma * rng.uniform(-1, 1, x.shape)

    starts = draw_starts(own, STEPS // 200, seed)
    runs = batch_loop(step, own, starts, 200, monitor)
    return sum(not monitor.judge(run, 200).outcome.kept for run in runs)


def changed(solution, **parts):
    fields = {name: getattr(solution, name) for name in ("grid", "winning", "mask", "free")}
    return Solution(**(fields | parts))


def test_no_start_comes_twice_where_it_would_draw_the_same_noise_again():
    inside = np.arange(40) < 20
    worst = WorstStarts(Solution(Grid(Box([0], [1]), [40]), inside, inside[:, None].astype(np.uint8), inside))
    rng = np.random.default_rng(4)
    assert len(np.unique(worst.draw(300, rng), axis=0)) < 200
    parts = [each_once(lambda n: worst.draw(n, rng), part, 2) for part in range(2)]
    assert len(np.unique(np.concatenate([draw(150) for draw in parts]), axis=0)) == 300


def test_a_sound_controller_survives(problem):
    found = attack(problem, problem[3])
    assert found.violations == 0
    assert found.steps >= STEPS
    assert set(found.ends) == {"stayed"}
    assert min(found.by.values()) > 0


def test_an_input_too_many_is_found(problem):
    """At every tenth cell of the edge both extreme inputs are admitted; least effort never takes them."""
    solution = problem[3]
    assert at_random(problem, solution) == 0
    mask, edge = solution.mask.copy(), np.flatnonzero(Danger.of(solution).edge == -1)
    for cell in edge[::10]:
        mask[cell, 0] |= 1  # input 0
        mask[cell, 3] |= 1  # input 24
    faulty = changed(solution, mask=mask)
    assert at_random(problem, faulty) == 0
    found = attack(problem, faulty)
    assert found.violations > 0
    assert found.broken[0].run.stuck


def test_cells_too_many_are_found(problem):
    """The winning domain claims all cells within four of its edge, each with the inputs of the nearest old one."""
    solution = problem[3]
    inside = solution.winning.reshape(solution.grid.cells)
    far, nearest = distance_transform_edt(~inside, return_indices=True)
    flat = np.ravel_multi_index(tuple(nearest), inside.shape).reshape(-1)
    winning = far.reshape(-1) <= 4
    mask = np.where(winning[:, None], solution.mask[flat], 0).astype(np.uint8)
    assert winning.sum() < 1.1 * solution.winning.sum()
    assert attack(problem, changed(solution, mask=mask, winning=winning)).violations > 0


def test_a_bound_too_small_is_found_in_closed_loop(problem):
    """The disturbance is a tenth larger than what the controller is made for; random ones of that size do no harm."""
    _, _, _, solution = problem
    larger = 1.6 * GAMMA
    assert at_random(problem, solution, larger) == 0
    assert attack(problem, solution, larger).violations > 0


def test_measurement_corners_are_part_of_the_attack(problem):
    """A controller for exact measurements breaks when they have an error; one made for the error does not."""
    _, _, abstraction, solution = problem
    error = np.array([0.0015, 0.012])
    assert attack(problem, solution, error=error).violations > 0
    made = plants.held_by_measurements(abstraction, error)
    assert made.winning.any()
    assert attack(problem, made, error=error).violations == 0


def test_a_sample_of_latency_is_part_of_the_attack(problem):
    _, inputs, abstraction, _ = problem
    error, first = np.array([0.0, 0.0]), int(np.argmin(np.abs(inputs[:, 0])))
    made = plants.held_by_measurements(abstraction, error, late=True, first=first)
    assert made.late
    found = attack(problem, made)
    assert found.violations == 0
    assert {run.rule for run in found.broken} == set()
    memory, mask = made.memory, made.mask.copy()
    served = np.flatnonzero(mask.any(axis=1))
    mask[served[served // memory % 3 == 0]] = 255  # every input, whatever is pending
    mask[:, -1] &= (1 << (len(inputs) - 8 * (mask.shape[1] - 1))) - 1
    faulty = Solution(made.grid, made.winning, mask, made.free, memory=memory, first=made.first, late=True)
    assert attack(problem, faulty).violations > 0


def test_runs_go_on_where_they_must_stay(problem):
    """Longer than the way to the target by as much as runs that only stay; without that, they end where they arrive."""
    asked = ReachAndStay(kind="reach_and_stay", target={"x1": (0.05, 0.15), "x2": (-0.25, 0.25)})
    made = asked.solve(NodeGame((problem[2],), SPACE, np.zeros(2)))
    way = int(made.value.max()) + 1
    assert way > 2
    monitor = asked.monitor(SPACE, made)
    found = attack(problem, made, monitor=monitor, holds=asked.holds)
    assert found.violations == 0
    assert found.steps == found.runs * (way + LENGTH)
    short = attack(problem, made, monitor=monitor, holds=False)
    assert short.steps == short.runs * way
