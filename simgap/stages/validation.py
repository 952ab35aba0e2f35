"""Stage `validation`: both controllers in the simulator and on the nominal model; what they promise is counted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.closed_loop import BEYOND, Judge, Policy, Sensing, batch_loop, closed_loop
from simgap.config.case import Case
from simgap.config.controller import Trials, ValidationSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.noise import NoiseStatement, statement_of
from simgap.geometry import drawn_in_cells
from simgap.io.arrays_on_disk import Mapped, scratch_folder
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import load_gap
from simgap.io.results import write_json, write_parquet
from simgap.io.traces import BASELINE, GAP_AWARE, MODEL, NOMINAL, SIMULATOR, Trace, to_table
from simgap.late import pyarrow as pa
from simgap.plants.context import Context
from simgap.provenance import CONTROLLED
from simgap.simulators.process import EnginePool, engine_pool
from simgap.specifications.base import Run, Verdict, specification_of
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.stages import CasePath, Gap, GapAwareController, HowMany, NominalController, Option, Out, Workers, log
from simgap.synthesis.controller import Controller

CHUNK = 50  # runs a worker does between two signs of life
TABLES = ".tables"  # folder beside the traces


def run(
    case_path: CasePath,
    nominal: NominalController,
    gap_aware: GapAwareController,
    gap_path: Gap,
    out: Out,
    traces: Annotated[Path, Option("File for the traces that are kept (Parquet).")],
    workers: Workers = 2,
    engine_log: Path | None = None,
    baseline: Annotated[Path | None, Option("Controller of the fair baseline.")] = None,
    trials: HowMany = Trials.PLAIN,
) -> None:
    """Run both controllers from the same starts, audit every step, keep a few traces.

    Args:
        trials: how many starts, where the case does not say it.
        baseline: a controller of the nominal model that checks the path between samples, to run too; no trace is kept.

    Raises:
        BrokenPromise: if the gap-aware controller violates anything in the simulator.
    """
    context = Context.load(case_path)
    section = context.need(context.case.validation, "validation")
    with context.blame():
        model, gap = context.plant.sampled, load_gap(gap_path, context).function
        specification, space = specification_of(context.case), Space.of(context.case)
    noise = statement_of(context.case)
    names, tolerated = (context.states, context.inputs, context.units), tolerated_share(context.case)
    record = context.record("validation", {"starts": section.seed}, CONTROLLED)
    tallies: dict[str, dict[str, Any]] = {}
    parts: list[pa.Table] = []
    shown: dict[int, Verdict] = {}  # by the nominal-only controller's runs in the simulator: the same starts for all
    paths = {NOMINAL: nominal, GAP_AWARE: gap_aware} | ({BASELINE: baseline} if baseline is not None else {})
    controllers = {kind: load_controller_of(path, context) for kind, path in paths.items()}
    with context.blame():
        others = {kind: one for kind, one in controllers.items() if kind != GAP_AWARE}
        begin = starts_by_kind(context, section, controllers[GAP_AWARE], others, trials)
    # A robot's table of inputs is a gigabyte: it is read and checked once, and the workers map what they look at. All
    # runs are given to them at once, so that they are started once and none waits for those of another controller.
    with scratch_folder(traces.parent / TABLES) as folder, engine_pool(workers, engine_log) as pool:
        jobs = {k: _submitted(pool, context, one, begin[k].x, folder / k) for k, one in controllers.items()}
        for kind, controller in controllers.items():
            with context.blame():
                monitor = specification.monitor(space, controller.solution)
            judge = Judge(space, monitor, section.steps, controller.input_set, model, gap)
            proven = replace(judge, certificate=controller.solution, tolerant=tolerated > 0, noisy=noise is not None)
            on_model = batch_loop(model.step, controller, begin[kind].x, section.steps, monitor)
            for plant, runs in ((SIMULATOR, _simulated(jobs[kind], len(begin[kind].x))), (MODEL, on_model)):
                own = proven if (kind, plant) == (GAP_AWARE, SIMULATOR) else judge
                figures, kept = own.count(runs, begin[kind].numbers.tolist(), section.kept, shown)
                shown = shown or kept
                tallies.setdefault(kind, {})[plant] = figures
                log.info("%s controller, %s: %s", kind, plant, _short(figures))
                about = {"case": context.case.name, "controller": kind, "plant": plant}
                if kind != BASELINE:
                    parts += [to_table(trace_of(judge, about, k, v), *names, about, record) for k, v in kept.items()]
    write_parquet(traces, pa.concat_tables(parts).unify_dictionaries())
    counts = {"trials": trials.value, "starts": section.count(trials), "steps": section.steps}
    said = {"noise": noise.of_run(section.steps)} if noise is not None else {}
    write_json(out, counts | {"controllers": tallies, **said, "provenance": record})
    keep_promise(tallies[GAP_AWARE][SIMULATOR], tolerated, noise)


def tolerated_share(case: Case) -> float:
    """The share of steps that may leave gamma: what the check of the bound on fresh samples was checked against."""
    if case.is_random and case.gap is not None:
        return case.gap.noise.alpha
    section = case.hidden_state if case.hidden_state is not None else case.gap
    return section.tolerated_probability if section is not None else 0.0


def keep_promise(tally: dict[str, Any], tolerated: float = 0.0, noise: NoiseStatement | None = None) -> None:
    """The gap-aware controller in the simulator must not violate anything; `tolerated` is the share of steps that may
    leave gamma where the case's bound promises no more. With noise, a run may fail after such a step.

    Raises:
        BrokenPromise: with the counts.
    """
    bad, outside = tally["runs_that_violated_it"], tally["steps_outside_gamma"]
    steps = tally["steps"]
    bad -= tally["ends"].get(BEYOND, 0) if noise is not None else 0
    if bad or (noise.is_contradicted(steps, outside) if noise is not None else outside > tolerated * steps):
        raise BrokenPromise(
            f"the gap-aware controller broke its promise: {bad} of {tally['runs']} runs violate the specification "
            f"or leave what is certified, {outside} of {steps} steps are outside gamma",
            "The gap bound does not cover the simulator: look at the tiers in gap.json, use a smaller eps.",
        )


def _short(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures without what is listed run by run."""
    return {name: value for name, value in figures.items() if not isinstance(value, list)}


def _submitted(
    pool: EnginePool, context: Context, controller: Controller, starts: Floats, tables: Path
) -> list[Future[list[Run]]]:
    """Runs of a controller, a chunk a job; its tables go to the file."""
    shared = Mapped.of(controller, tables)
    chunks = [starts[k : k + CHUNK] for k in range(0, len(starts), CHUNK)]
    return [pool.submit(simulate_chunk, context.case, context.folder, shared, x, k) for k, x in enumerate(chunks)]


def _simulated(jobs: Sequence[Future[list[Run]]], count: int) -> Iterator[Run]:
    """Runs in the order of their starts, `count` of them."""
    for k, job in enumerate(jobs):
        yield from job.result()
        if (k + 1) % 5 == 0 or k + 1 == len(jobs):
            log.info("simulated %d of %d runs", min((k + 1) * CHUNK, count), count)


def simulate_chunk(case: Case, folder: Path, shared: Mapped[Controller], starts: Floats, chunk: int) -> list[Run]:
    """Run in an engine's process, from starts (n, nx)."""
    controller = shared.read()
    return simulate(case, folder, controller, controller.solution, starts, chunk)


def simulate(case: Case, folder: Path, policy: Policy, solution: Solution, starts: Floats, chunk: int = 0) -> list[Run]:
    """Runs of a policy in the case's simulator, from starts (n, nx); `solution` says when one is over.

    Call it in the process that will run the simulator.
    """
    from simgap.simulators.rollouts import make_simulator

    space, section = Space.of(case), case.sensing
    sensing = Sensing(space.vector(section.error if section else {}), section.latency if section else 0)
    steps, seed = (case.validation.steps, case.validation.seed) if case.validation else (0, 0)
    monitor = specification_of(case).monitor(space, solution)
    rng = np.random.default_rng([chunk, seed])
    with make_simulator(case, folder) as simulator:
        return [
            closed_loop(simulator, policy, x, steps, sensing, rng, monitor, sensing.measure(x, rng)) for x in starts
        ]


def trace_of(judge: Judge, about: dict[str, str], number: int, verdict: Verdict) -> Trace:
    """One kept run; at the last state there is no input, and its cells are not numbers."""
    run, audit = verdict.run, judge.audit([verdict.run])
    which, steps = (about["controller"], about["plant"], number), (audit.d, audit.lo, audit.hi)
    return Trace.of(which, judge.model.tau, run.x, (judge.inputs[run.inputs], *steps), verdict.safe)


class StartStates(NamedTuple):
    """States x (n, nx), and their numbers (n,): the same state has the same number for every controller."""

    x: Floats
    numbers: Ints


def starts(context: Context, section: ValidationSection, controller: Controller, count: int) -> Floats:
    """`count` states of the winning domain, those of `validation.first` in front: (n, nx).

    Raises:
        UserError: a given start that does not name every state, or lies outside X or outside the winning domain.
    """
    given = [given_start(context, controller, number, named) for number, named in enumerate(section.first)]
    drawn = draw_starts(controller, max(count - len(given), 0), section.seed)
    return np.concatenate([np.array(given).reshape(-1, len(context.states)), drawn])


def starts_by_kind(
    context: Context,
    section: ValidationSection,
    gap_aware: Controller,
    others: Mapping[str, Controller],
    trials: Trials = Trials.PLAIN,
) -> dict[str, StartStates]:
    """Starts of the gap-aware controller, and the first of them that each of the others wins too.

    One that wins none of them begins in its own winning domain.

    Raises:
        UserError: as `starts` does.
    """
    own, most = starts(context, section, gap_aware, section.count(trials)), section.baseline_count(trials)
    begin = {GAP_AWARE: StartStates(own, np.arange(len(own)))}
    for kind, other in others.items():
        shared = np.flatnonzero(other.contains(own))[:most]
        apart = starts(context, section, other, most) if not len(shared) else own[:0]
        begin[kind] = (
            StartStates(own[shared], shared) if len(shared) else StartStates(apart, len(own) + np.arange(len(apart)))
        )
    return begin


def given_start(context: Context, controller: Controller, number: int, named: dict[str, float]) -> Floats:
    """One start of the case as a state, (nx,)."""
    key = f"validation.first[{number}]"
    if sorted(named) != sorted(context.states):
        remedy = f"Give a value for each of {', '.join(context.states)}."
        raise UserError(f"the start names {', '.join(named) or 'no state'}", key=key, remedy=remedy)
    for name in context.states:
        lo, hi = context.domain.X[name]
        if not lo <= named[name] <= hi:
            raise UserError(
                f"the start lies outside X: {name} = {named[name]:g} is not in [{lo:g}, {hi:g}]", key=key,
                remedy="Move it inside, or enlarge domain.X.",
            )  # fmt: skip
    x = np.array([named[name] for name in context.states])
    if not controller.contains(x[None])[0]:
        problem = f"the controller promises nothing from the start {named}: it is not in the winning domain"
        raise UserError(problem, key=key, remedy="Move it away from obstacles and walls, or remove it.")
    return x


def draw_starts(controller: Controller, count: int, seed: int) -> Floats:
    """Points of the winning domain: (count, nx); half of them inside a cell, the rest on its faces and its corners.

    Cells are drawn uniformly from those where a run does not end at once: a start in the target proves nothing.
    """
    rng = np.random.default_rng(seed)
    return drawn_in_cells(controller.grid, rng.choice(controller.solution.beginnings, count), rng, (3,))
