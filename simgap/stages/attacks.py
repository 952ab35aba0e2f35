"""What the stage `audit` does in engine processes: each job reads what it needs, attacks, and gives counts back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.attack.campaign import Campaign, Opponent, campaign
from simgap.attack.danger import Danger
from simgap.attack.histories import HistoryQuestion, HistorySearch
from simgap.attack.law import Law
from simgap.attack.memory import class_bounds
from simgap.attack.plants import OneByOne, RolledOut, WorstDisturbance
from simgap.attack.points import PointSearch, Question
from simgap.attack.rules import Scene
from simgap.attack.seeds import border
from simgap.attack.share import Searched, share
from simgap.attack.starts import WorstStarts
from simgap.config.case import Case
from simgap.config.pose import pose_axes
from simgap.gap.borders import critical_points
from simgap.gap.function import GapDomain, GapFunction
from simgap.gap.load import from_json
from simgap.gap.steps.samples import motion_of
from simgap.gap.switching import switching_surfaces
from simgap.gap.symmetry import BodyFrameGap
from simgap.geometry import Floats
from simgap.io.shared_solution import SharedSolution
from simgap.judge import Judge
from simgap.simulators.base import PathSimulator, Simulator
from simgap.simulators.body_samples import BodySamples
from simgap.simulators.build import make_simulator
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages.context import Context

TOGETHER = 32  # runs side by side
MOST_PLACES = 2_000  # states on the border of X and beside switching surfaces; a finer lattice is thinned


@dataclass(frozen=True, eq=False)
class Job:
    """One part of the audit.

    Attributes:
        case, path: the case and its file. gap: content of gap.json. seed: of this part alone.
        solution: the controller's. danger, beginnings: over its cells. margin: (cells,) of those that win, or None
            where it is not known.
        evaluations, steps: of this part.
        known: where searches over the gap begin, worst first: states (n, nx) and input numbers (n,), or sequences of
            input numbers (n, length + 1).
    """

    case: Case
    path: Path
    gap: dict[str, Any]
    seed: tuple[int, int]
    solution: SharedSolution
    danger: Danger
    beginnings: Any
    margin: Any
    evaluations: int
    steps: int
    known: tuple[Any, ...]


def attack(job: Job) -> tuple[Searched, dict[str, Campaign]]:
    """Everything that one part does: the gap, then the closed loop in the simulator and against the disturbance."""
    context = Context(job.case, job.path)
    simulator, gap = make_simulator(job.case, context.folder), from_json(job.gap)
    rng = np.random.default_rng(job.seed)
    try:
        if job.case.hidden_state is not None:
            found = _histories(context, simulator, gap, job, rng)
        else:
            found = PointSearch(question(context, simulator, gap), job.evaluations, rng).run(*job.known)
        return found, _loops(context, simulator, gap, job, found, rng)
    finally:
        simulator.close()


def question(context: Context, simulator: Simulator, gap: GapFunction) -> Question:
    """The gap of a simulator that is a function of state and input, or a range of it where commands are late."""

    def successors(x: Floats, u: Floats) -> tuple[Floats, Floats]:
        if simulator.remembers:
            return simulator.spread(x, u)
        following = simulator.rollouts(x, u)
        return following, following

    step, domain = context.plant.sampled.step, gap.domain
    at = places(context, domain)
    return Question(successors, step, gap.bounds, context.box, context.input_set, domain.free, at)


def places(context: Context, domain: GapDomain) -> Floats:
    """Where a gap may jump, (n, nx): the border of X, and both sides of the switching surfaces of the case."""
    beside = critical_points(domain, switching_surfaces(context), most=MOST_PLACES).x
    return np.unique(np.concatenate([border(context.box, domain.free), beside]), axis=0)


def _histories(context: Context, robot: Simulator, gap: GapFunction, job: Job, rng: np.random.Generator) -> Searched:
    hidden = context.need(context.case.hidden_state, "hidden_state")
    search = HistorySearch(history_question(context, robot, gap, hidden.length), job.evaluations, rng)
    return search.run(*job.known)


def history_question(context: Context, robot: Simulator, gap: GapFunction, length: int) -> HistoryQuestion:
    """The gap of a robot in its own frame."""
    assert isinstance(robot, PathSimulator)
    assert isinstance(gap, BodyFrameGap)
    motion, pose = motion_of(context), pose_axes(context)

    def gaps(m: Any, heading: float) -> Floats:
        start = np.zeros(3)
        start[pose[2]] = heading
        paths = robot.chain(start, context.input_set[m])[1]
        return BodySamples.of_paths(m, paths, robot.pose).final - motion[m]

    def bounds(m: Any, before: Any) -> tuple[Floats, Floats]:
        return class_bounds(gap, m, before)

    return HistoryQuestion(gaps, bounds, context.input_set, length, pose[2])


def _loops(
    context: Context, simulator: Simulator, gap: GapFunction, job: Job, found: Searched, rng: np.random.Generator
) -> dict[str, Campaign]:
    """Both campaigns: in the simulator and against the worst disturbance."""
    case, space = context.case, Space.of(context.case)
    solution, danger = job.solution.read(), job.danger
    monitor = specification_of(case).monitor(space, solution)
    error = space.vector(case.sensing.error if case.sensing else {})
    law = Law(solution, context.input_set, error)
    model, inputs = context.plant.sampled, context.input_set
    most = case.validation.steps if case.validation is not None else 2000
    judge = Judge(space, monitor, most, inputs, model, gap, solution)

    def predict(x: Floats, m: Any, before: Any) -> Floats:
        lo, hi = gap.bounds_after(space.wrapped(x), inputs[m], before)
        return model.step(x, inputs[m]) + 0.5 * (lo + hi)

    def use(x: Floats, m: Any) -> Floats:
        u = inputs[m]
        d, (lo, hi) = simulator.rollouts(x, u) - model.step(x, u), gap.bounds(x, u)
        return share(d, d, lo, hi)

    holds = specification_of(case).holds
    memoryless = case.hidden_state is None and not simulator.remembers
    plant: Any = RolledOut(simulator) if memoryless else OneByOne(simulator, monitor)
    scene = Scene(predict, use if memoryless else None, danger, inputs, solution.late)
    modelled = Scene(predict, None, danger, inputs, solution.late)
    disturbed = WorstDisturbance(
        model.step, lambda x, u, before: gap.bounds_after(space.wrapped(x), u, before), danger, monitor, rng
    )

    worst = WorstStarts(danger, job.margin, job.beginnings)

    def starts(count: int) -> Floats:
        return worst.draw(count, rng)

    return {
        "simulator": campaign(
            Opponent(plant, judge, True, TOGETHER if memoryless else 1, holds), law, scene, starts, job.steps, rng
        ),
        "disturbance": campaign(
            Opponent(disturbed, judge, False, TOGETHER, holds), law, modelled, starts, job.steps, rng
        ),
    }
