"""Stage `audit`: an adversary with a budget against the bound and the controller; one violation fails the run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.attack.campaign import Campaign, Opponent, campaign
from simgap.attack.danger import Danger, WorstStarts, beginnings
from simgap.attack.histories import HistoryQuestion, search_histories
from simgap.attack.known import border, worst_histories, worst_steps
from simgap.attack.law import Law, class_bounds
from simgap.attack.plants import OneByOne, RolledOut, WorstDisturbance
from simgap.attack.points import PointSearch, Question
from simgap.attack.rules import Scene
from simgap.attack.share import Searched, share
from simgap.attack.witness import DISTURBANCE, SIMULATOR, Witness
from simgap.config.case import Case
from simgap.config.reads import CONTROLLED
from simgap.config.validation import AuditSection, Trials
from simgap.errors import BrokenPromise
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, GapFunction
from simgap.gap.bounds.load import from_json
from simgap.gap.sampling.borders import critical_points, switching_surfaces
from simgap.gap.sampling.samples import motion_of
from simgap.io.controller_file import load_controller_of
from simgap.io.documents import write_json
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.parquet import table, write_parquet
from simgap.io.shared_solution import SharedSolution
from simgap.judge import Judge
from simgap.plants.context import Context, pose_axes
from simgap.provenance import provenance
from simgap.simulators.base import PathSimulator, Simulator
from simgap.simulators.body_samples import BodySamples
from simgap.simulators.process import EnginePool, engine_pool
from simgap.simulators.rollouts import make_simulator
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import log
from simgap.stages.arguments import CasePath, Gap, HowMany, Option, Out, Shards, Workers
from simgap.stages.gap_inputs import read_samples
from simgap.stages.margins import margins_of, summary
from simgap.stages.scratch import scratch_folder
from simgap.stages.validation import tolerated_share
from simgap.synthesis.margins import Margins

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
    return search_histories(history_question(context, robot, gap, hidden.length), job.evaluations, rng, *job.known)


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


TABLES = ".tables"  # folder beside the counts
PARTS = 2  # each with random numbers of its own, whatever the number of workers


@dataclass(frozen=True)
class AuditFiles:
    """Files that the audit reads: the bound, the gap-aware controller, its roll-outs and the fresh samples."""

    gap: Gap
    controller: Annotated[Path, Option("Controller made for the model with its gap.")]
    rollouts: Shards
    fresh: Annotated[Path, Option("Fresh samples (Parquet).")]


@dataclass(frozen=True)
class AuditOutputs:
    """Files that it writes: the counts, the margins of every cell, and what breaks the promise, if anything does."""

    counts: Out
    margins: Annotated[Path, Option("File for the margins of every cell (Parquet).")]
    witness: Annotated[Path, Option("File for what breaks the promise, if anything does (JSON).")]


def run(
    case_path: CasePath,
    inputs: AuditFiles,
    out: AuditOutputs,
    workers: Workers = 2,
    engine_log: Path | None = None,
    trials: HowMany = Trials.PLAIN,
) -> None:
    """Attack with the budget of the case, count, and write what was found.

    Raises:
        BrokenPromise: one broken run, whatever the case tolerates; one step of the simulator outside gamma, unless it
            tolerates a share of them.
    """
    context = Context.load(case_path)
    section = context.case.audit or AuditSection()
    for old in (out.witness, *out.witness.parent.glob(f"{out.witness.stem}-*{out.witness.suffix}")):
        old.unlink(missing_ok=True)
    with context.blame():
        bound = load_gap(inputs.gap, context)
        known = _known(context, bound, inputs)
    # A robot's table of inputs is a gigabyte: it is read and checked here, and the workers map what they look at.
    with scratch_folder(out.counts.parent / TABLES) as folder:
        with context.blame():
            shared, margins = _shared(context, bound.function, inputs.controller, folder)
        jobs = _jobs(context, section, bound, shared, known, trials)
        with engine_pool(workers, engine_log) as pool:
            parts = _done(pool, jobs)
    found = Searched.joined([part for part, _ in parts])
    loops = {name: Campaign.joined([own[name] for _, own in parts]) for name in (SIMULATOR, DISTURBANCE)}
    record = provenance("audit", context.case, context.folder, {"audit": section.seed}, CONTROLLED)
    witnesses = _witnesses(context, found, loops)
    content = counts(found, loops, context.states) | {"margins": summary(context, margins), "provenance": record}
    if isinstance(margins, str):
        content |= {"no_margins": margins}
    for number, witness in enumerate(one_of_each_kind(witnesses), 1):
        _keep(context, case_path, bound, witness, _numbered(out.witness, number))
    _write_margins(context, margins, out.margins, record)
    write_json(out.counts, content | {"witnesses": [w.what for w in witnesses]})
    log.info("%s", _said(content))
    if loops[DISTURBANCE].violations or (content["violations"] and not tolerated_share(context.case)):
        raise BrokenPromise(
            f"the adversary broke it: {_said(content)}; the first: {witnesses[0].what}",
            f"`simgap replay {out.witness}` shows it{_beside(witnesses)}. {_remedy(found)}",
        )


def _write_margins(context: Context, margins: Margins | str, path: Path, record: Mapping[str, Any]) -> None:
    """A row a cell; none where there are no margins."""
    columns: dict[str, Any] = {"factor": np.empty(0, np.float32)}
    if not isinstance(margins, str):
        columns = {"factor": margins.factor} | {f"extra_{n}": margins.extra[:, j] for j, n in enumerate(context.states)}
    units = {f"extra_{n}": context.units[n] for n in context.states}
    write_parquet(path, table(columns, units, {"case": context.case.name}, record))


def _beside(witnesses: Sequence[Witness]) -> str:
    others = len(one_of_each_kind(witnesses)) - 1
    return f", and {others} of other kinds beside it" if others else ""


def _remedy(found: Searched) -> str:
    if found.violations:
        return "The bound does not cover the simulator: use a smaller eps, or longer histories."
    return "The bound held: the fault is in the abstraction or in the specification."


def _done(pool: EnginePool, jobs: list[Job]) -> list[tuple[Searched, dict[str, Campaign]]]:
    return [job.result() for job in [pool.submit(attack, job) for job in jobs]]


@dataclass(frozen=True, eq=False)
class _Ground:
    """Common ground of all parts: the solution, and what makes its cells narrow."""

    solution: SharedSolution
    danger: Danger
    beginnings: Any
    margin: Any


def _shared(
    context: Context, gap: GapFunction, controller: Path, scratch_folder: Path
) -> tuple[_Ground, Margins | str]:
    """Read the controller, look at all of its cells once, and leave its tables in a folder."""
    solution = load_controller_of(controller, context).solution
    margins = margins_of(context, gap, solution)
    factor = None if isinstance(margins, str) else margins.factor
    shared = SharedSolution.of(solution, scratch_folder)
    return _Ground(shared, Danger.of(solution), beginnings(solution), factor), margins


def _known(context: Context, bound: SavedGap, inputs: AuditFiles) -> tuple[Any, ...]:
    """Where searches over the gap begin."""
    hidden = context.case.hidden_state
    tables = [read_samples(context, path, "rollouts", "borders") for path in inputs.rollouts]
    tables.append(read_samples(context, inputs.fresh, "fresh"))
    if hidden is None:
        return worst_steps(context, bound.function, tables)
    return (worst_histories(context, bound.function, motion_of(context), tables, hidden.length),)


def _jobs(
    context: Context, section: AuditSection, bound: SavedGap, ground: _Ground, known: tuple[Any, ...], trials: Trials
) -> list[Job]:
    """The parts; what is known goes to them in turns."""
    evaluations, steps = section.budget(context.case.hidden_state is not None, trials)
    return [
        Job(
            case=context.case,
            path=context.path,
            gap=bound.content,
            seed=(section.seed, part),
            solution=ground.solution,
            danger=ground.danger,
            beginnings=ground.beginnings,
            margin=ground.margin,
            evaluations=-(-evaluations // PARTS),
            steps=-(-steps // PARTS),
            known=tuple(a[part::PARTS] for a in known),
        )
        for part in range(PARTS)
    ]


def counts(found: Searched, loops: Mapping[str, Campaign], states: Sequence[str]) -> dict[str, Any]:
    """Counts of what was tried and found, as plain data."""
    worst = found.worst
    return {
        "evaluations": found.evaluations,
        "steps": loops[SIMULATOR].steps,
        "violations": found.violations + sum(loop.violations for loop in loops.values()),
        "gap": {
            "violations": found.violations,
            "evaluations_by_search": found.by,
            "largest_share": None if worst is None else worst.share,
            "worst": None if worst is None else dict(zip(states, worst.x.tolist(), strict=True)),
        },
        "closed_loop": {name: loop.to_json() for name, loop in loops.items()},
    }


def _said(content: Mapping[str, Any]) -> str:
    loops = content["closed_loop"]
    return (
        f"{content['gap']['violations']:,} of {content['evaluations']:,} chosen evaluations lie outside gamma, "
        + " and ".join(
            f"{loops[name]['violations']:,} of {loops[name]['runs']:,} runs ({loops[name]['steps']:,} steps) {where} "
            "break the promise"
            for name, where in ((SIMULATOR, "in the simulator"), (DISTURBANCE, "against the worst disturbance"))
        )
    )


def _witnesses(context: Context, found: Searched, loops: Mapping[str, Campaign]) -> list[Witness]:
    out = [Witness.of_step(step, (context.states, context.inputs)) for step in found.outside]
    for name, loop in loops.items():
        out += [Witness.of_run(name, broken, context.input_set) for broken in loop.broken]
    return out


def one_of_each_kind(witnesses: Sequence[Witness]) -> list[Witness]:
    """The first of each kind: steps outside gamma, and runs by the plant and by how they end; at least one of all."""
    first: dict[tuple[str, ...], Witness] = {}
    for witness in witnesses:
        first.setdefault((witness.kind, witness.plant, witness.end, str(len(witness.inputs) == 0)), witness)
    return list(first.values())


def _numbered(path: Path, number: int) -> Path:
    """`witness.json`, `witness-2.json`, ..."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def _keep(context: Context, case_path: Path, bound: SavedGap, witness: Witness, out: Path) -> None:
    """The witness with its case, from where it lies, and its bound."""
    where = os.path.relpath(reading.real(case_path), reading.real(out).parent)
    record = provenance("audit", context.case, context.folder, rests=CONTROLLED)
    write_json(out, witness.to_json() | {"case": where, "gap": bound.content, "provenance": record})
