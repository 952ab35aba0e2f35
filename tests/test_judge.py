"""What counts as a violation of a controller that proves something, on runs made by hand."""

from dataclasses import replace

import numpy as np
import sympy as sp

from simgap.closed_loop import LEFT, Judge, strays
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.bounds.previous import PreviousClasses
from simgap.geometry import Box, Grid
from simgap.model.sampled import NominalModel
from simgap.specifications.arena import Surroundings
from simgap.specifications.base import Run
from simgap.specifications.invariance import Inside
from simgap.specifications.reaching import Arriving
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space

PI = np.pi
BOX = Box([0.0, 0.0, -PI], [6.0, 1.0, PI])
SPACE = Space(("x", "y", "t"), BOX, (2,), {}, (0, 1, 2))
GRID = Grid(BOX, (6, 1, 1), (2,))
INPUTS = np.array([[-1.0], [1.0]])


def model():
    x, y, t, v = sp.symbols("x y t v", real=True)
    return NominalModel((x, y, t), (v,), (x + v, y, t), 1.0)


def gap(size):
    domain = GapDomain(("x", "y", "t"), ("v",), BOX, INPUTS, (0, 1))
    return BodyFrameGap(domain, (), np.full((1, 2, 3), -size), np.full((1, 2, 3), size))


def corridor(levels):
    """Six cells in a row with levels towards the last one."""
    value = np.array(levels, np.int32)
    mask = np.where(value > 0, 3, 0).astype(np.uint8)[:, None]
    return Solution(GRID, value >= 0, mask, np.ones(6, bool), value, value == 0)


def along(xs, inputs):
    x = np.column_stack([xs, np.full(len(xs), 0.5), np.zeros(len(xs))])
    return Run(x, np.array(inputs), False, x, np.ones(len(xs)))


def judged(solution, run, size, **more):
    around = Surroundings.of(SPACE, (), BOX, np.zeros(3))
    target = Box([5.0, -np.inf, -np.inf], [6.0, np.inf, np.inf])
    judge = Judge(SPACE, Arriving(SPACE, target, around, solution), 20, INPUTS, model(), gap(size), **more)
    return judge.count([run], [0], 1)[0]


def test_a_run_that_climbs_and_gets_there_all_the_same_is_a_violation():
    solution = corridor([5, 4, 3, 2, 1, 0])
    run = along([1.5, 2.5, 1.5, 2.5, 3.5, 4.5, 5.5], [1, 0, 1, 1, 1, 1])
    assert judged(solution, run, 0.1)["runs_that_violated_it"] == 0  # a controller that proves nothing of this plant
    figures = judged(solution, run, 0.1, certificate=solution)
    assert figures["ends"] == {LEFT: 1}
    assert figures["runs_that_violated_it"] == 1


def test_a_run_with_a_step_outside_gamma_that_gets_there_is_a_violation():
    solution = corridor([5, 4, 3, 2, 1, 0])
    run = along([1.5, 2.5, 3.5, 4.9, 5.5], [1, 1, 1, 1])  # 0.4 m farther than the model, then 0.4 m less
    figures = judged(solution, run, 0.1, certificate=solution)
    assert (figures["steps_outside_gamma"], figures["runs_that_violated_it"]) == (2, 1)
    assert judged(solution, run, 0.5, certificate=solution)["runs_that_violated_it"] == 0
    # a case that tolerates a share of such steps judges the run by what it did
    assert judged(solution, run, 0.1, certificate=solution, tolerant=True)["runs_that_violated_it"] == 0


def test_a_run_that_leaves_the_winning_domain_and_comes_back_is_a_violation():
    grid = Grid(Box([0.0], [4.0]), (4,))
    winning = np.array([False, True, True, False])
    solution = Solution(grid, winning, np.where(winning, 3, 0).astype(np.uint8)[:, None], np.ones(4, bool))
    x = np.array([[1.5], [0.5], [1.5], [2.5]])
    run = Run(x, np.array([0, 1, 1]), False, x)
    assert Inside(Box([0.0], [4.0])).judge(run, 3).outcome.kept
    assert strays(solution, run) == 1
    assert strays(solution, Run(x[2:], np.array([1]), False, x[2:])) == 0


def test_a_step_that_stays_at_its_level_comes_no_nearer():
    solution = corridor([5, 4, 3, 2, 1, 0])
    assert strays(solution, along([1.5, 1.6, 2.5], [0, 1])) == 1
    assert strays(solution, along([1.5, 1.6, 1.7], [0, 1])) == 2


def test_a_step_is_held_against_the_bound_after_the_input_before_it_and_not_its_own():
    inputs = np.array([[-1.0], [0.0], [1.0]])
    sizes = np.array([0.1, 0.3, 0.5])[:, None, None] * np.ones((3, 3, 3))  # after -1, after rest or 0, after 1
    domain = GapDomain(("x", "y", "t"), ("v",), BOX, inputs, (0, 1))
    bound = BodyFrameGap(domain, (), -sizes, sizes, classes=PreviousClasses.of(inputs, (3,)))
    around = Surroundings.of(SPACE, (), BOX, np.zeros(3))
    solution = corridor([5, 4, 3, 2, 1, 0])
    judge = Judge(SPACE, Arriving(SPACE, BOX, around, solution), 20, inputs, model(), bound)
    # 0.2 m beyond the model in each step: within what may follow rest, 0 and 1, beyond what may follow -1
    two = [along([1.5, 2.7, 1.9, 3.1], [2, 0, 2]), along([2.5, 1.7, 2.9], [0, 2])]
    assert judge.audit(two).outside.tolist() == [False, False, True, False, True]


def test_a_turn_of_the_heading_is_no_gap_and_a_state_beyond_the_grid_is_nowhere():
    x = np.array([[1.5, 0.5, PI - 0.1], [2.5, 0.5, PI + 0.05], [3.5, 0.5, PI + 0.05]])
    around, solution = Surroundings.of(SPACE, (), BOX, np.zeros(3)), corridor([5, 4, 3, 2, 1, 0])
    judge = Judge(SPACE, Arriving(SPACE, BOX, around, solution), 20, INPUTS, model(), gap(0.2))
    turned = judge.audit([Run(x + np.array([0.0, 0.0, 2 * PI]), np.array([1, 1]), False, x)])
    assert not turned.outside.any()
    assert np.allclose(turned.d, [[0.0, 0.0, 0.15], [0.0, 0.0, 0.0]])
    grid = Grid(Box([0.0], [4.0]), (4,))
    every = Solution(grid, np.ones(4, bool), np.full((4, 1), 3, np.uint8), np.ones(4, bool))
    gone = np.array([[3.5], [4.5]])
    assert strays(every, Run(gone, np.array([1]), False, gone)) == 1


def test_a_held_target_is_never_left():
    solution = corridor([5, 4, 3, 2, 0, 0])
    assert strays(solution, along([3.5, 4.5, 5.5, 4.5], [1, 1, 0])) == 0
    assert strays(solution, along([3.5, 4.5, 3.5, 4.5], [1, 0, 1])) == 1


def test_levels_are_those_of_the_cell_and_the_pending_input():
    value = np.array([[5, 3], [4, 2], [3, 1], [2, 1], [1, 1], [0, 0]], np.int32)
    mask = np.where(value > 0, 3, 0).astype(np.uint8).reshape(-1, 1)
    nodes = value.reshape(-1)
    late = Solution(GRID, value[:, 0] >= 0, mask, np.ones(6, bool), nodes, nodes == 0, 2, {}, 0, True)
    run = along([1.5, 2.5, 3.5], [1, 1])
    falls = Run(run.x, run.inputs, False, run.x, run.clearance, np.array([0, 0, 1]))  # 4, 3, 1
    climbs = Run(run.x, run.inputs, False, run.x, run.clearance, np.array([1, 0, 0]))  # 2, 3, 2
    assert (strays(late, falls), strays(late, climbs)) == (0, 1)
    assert late.levels(run.x[:1]).tolist() == [4]


def test_a_pending_input_that_may_not_act_from_where_the_plant_is_leaves_the_certificate():
    """A controller that knows measurements of the sample before keeps pairs of a true cell and the input that acts."""
    may = np.array([[3], [3], [3], [1], [1], [0]], np.uint8)
    mask = np.full((12, 1), 3, np.uint8)
    own = Solution(GRID, may[:, 0] & 1 == 1, mask, np.ones(6, bool), memory=2, late=True, acting=may)
    run = along([1.5, 2.5, 3.5], [1, 1])
    held = Run(run.x, run.inputs, False, run.x, run.clearance, np.array([1, 1, 0]))
    left = Run(run.x, run.inputs, False, run.x, run.clearance, np.array([1, 1, 1]))
    assert (strays(own, held), strays(own, left)) == (0, 1)
    gone = Run(run.x + np.array([[0.0], [0.0], [9.0]]), run.inputs, False, run.x, run.clearance, np.array([1, 1, 0]))
    assert strays(own, gone) == 1


def test_the_same_starts_are_looked_at_for_every_controller_and_plant():
    """The first runs and the first that fails, by the numbers of their starts; then these, fail what may."""
    solution = corridor([5, 4, 3, 2, 1, 0])
    around = Surroundings.of(SPACE, (), BOX, np.zeros(3))
    target = Box([5.0, -np.inf, -np.inf], [6.0, np.inf, np.inf])
    judge = Judge(SPACE, Arriving(SPACE, target, around, solution), 20, INPUTS, model(), gap(0.1))
    good, bad = along([4.5, 5.5], [1]), along([4.5, 4.5], [1])
    kept = judge.count([good, good, good, bad, bad], [0, 2, 4, 6, 8], 3)[1]
    assert list(kept) == [0, 2, 6]
    assert [v.outcome.kept for v in kept.values()] == [True, True, False]
    runs = [good, bad, *[good] * 7]
    assert list(judge.count(runs, range(9), 3, kept)[1]) == [0, 2, 6]
    promised = replace(judge, certificate=solution)  # a broken promise is kept to be seen, wherever it began
    assert list(promised.count([*runs, bad], range(10), 3, kept)[1]) == [0, 1, 2, 6]
    assert list(judge.count(runs, range(100, 109), 3, kept)[1]) == [100, 101, 102]  # none of these starts is its own
