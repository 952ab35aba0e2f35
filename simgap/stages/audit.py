"""Stage `audit`: an adversary with a budget against the bound and the controller; one violation fails the run.

Its margins say by how much gamma could grow before a winning cell is lost, and over which cells.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Never

import numpy as np

from simgap import reading
from simgap.attack.campaign import Campaign, WorstStarts, attack_loops
from simgap.attack.witness import DISTURBANCE, SIMULATOR, Witness
from simgap.attack.worst_step import (
    GapProblem,
    HistoryProblem,
    SearchRecord,
    search_histories,
    search_points,
    worst_histories,
    worst_steps,
)
from simgap.config.case import Case
from simgap.config.controller import AuditSection, Trials
from simgap.errors import BrokenPromise
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.load import from_json
from simgap.gap.noise import NoiseStatement, statement_of
from simgap.gap.sampling.samples import motion_of
from simgap.io.arrays_on_disk import Mapped, scratch_folder
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.results import table, write_json, write_parquet
from simgap.plants.context import Context
from simgap.provenance import CONTROLLED
from simgap.simulators.process import engine_pool
from simgap.simulators.rollouts import make_simulator
from simgap.specifications.solution import Solution
from simgap.stages import CasePath, Gap, HowMany, Option, Out, Shards, Workers, log
from simgap.stages.gap_inputs import read_samples
from simgap.stages.validation import tolerated_share
from simgap.synthesis.margins import CAUSES, LARGEST_FACTOR, NOTHING, Margins, margins_of

SHARES = (0.0, 0.05, 0.5)  # quantiles of the margins that are printed


def summary(context: Context, margins: Margins | str) -> dict[str, Any] | None:
    """Least, 5 % and median margin over the cells that have one, how many cells that is, and which ones only."""
    if isinstance(margins, str):
        return None
    known = margins.factor >= 1.0
    if not known.any():
        return None

    def quantiles(values: Any) -> dict[str, float]:
        named = zip(("least", "five_percent", "median"), np.quantile(values, SHARES, method="lower"), strict=True)
        return {name: float(v) for name, v in named}

    return {
        "cells": int(known.sum()),
        "lose_by": {cause: int(np.sum(margins.loses_by == k)) for k, cause in enumerate(CAUSES) if k != NOTHING},
        **({"only": margins.only} if margins.only else {}),
        "factor": quantiles(margins.factor[known]),
        "largest_looked_for": LARGEST_FACTOR,
    }


@dataclass(frozen=True, eq=False)
class Job:
    """One part of the audit.

    Attributes:
        case, path: the case and its file. gap: content of gap.json. seed: of this part alone.
        solution: the controller's. starts: of runs, by what makes its cells narrow.
        evaluations, steps: of this part.
        known: where searches over the gap begin, worst first: states (n, nx) and input numbers (n,), or sequences of
            input numbers (n, length + 1).
    """

    case: Case
    path: Path
    gap: dict[str, Any]
    seed: tuple[int, int]
    solution: Mapped[Solution]
    starts: WorstStarts
    evaluations: int
    steps: int
    known: tuple[Any, ...]


def attack(job: Job) -> tuple[SearchRecord, dict[str, Campaign]]:
    """Everything that one part does: the gap, then the closed loop in the simulator and against the disturbance."""
    context = Context(job.case, job.path)
    gap, rng, hidden = from_json(job.gap), np.random.default_rng(job.seed), job.case.hidden_state
    with make_simulator(job.case, context.folder) as simulator:
        if hidden is not None:
            problem = HistoryProblem.of(context, simulator, gap, hidden.length)
            found = search_histories(problem, job.evaluations, rng, *job.known)
        else:
            found = search_points(GapProblem.of(context, simulator, gap), job.evaluations, rng, *job.known)
        solution, part = job.solution.read(), (job.seed[1], PARTS)
        return found, attack_loops(context, simulator, gap, solution, job.starts, job.steps, rng, part)


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
            solution, starts, margins = _shared(context, bound.function, inputs.controller, folder)
        evaluations, steps = (-(-n // PARTS) for n in section.budget(context.case.hidden_state is not None, trials))
        about = context.case, context.path, bound.content
        jobs = [
            Job(
                *about, (section.seed, part), solution, starts, evaluations, steps, tuple(a[part::PARTS] for a in known)
            )
            for part in range(PARTS)
        ]
        with engine_pool(workers, engine_log) as pool:
            parts = [job.result() for job in [pool.submit(attack, job) for job in jobs]]
    found = SearchRecord.joined([part for part, _ in parts])
    loops = {name: Campaign.joined([own[name] for _, own in parts]) for name in (SIMULATOR, DISTURBANCE)}
    record = context.record("audit", {"audit": section.seed}, CONTROLLED)
    witnesses = _witnesses(context, found, loops)
    noise = statement_of(context.case)
    content = counts(found, loops, context.states, noise) | {"margins": summary(context, margins), "provenance": record}
    if isinstance(margins, str):
        content |= {"no_margins": margins}
    kinds = one_of_each_kind(witnesses)
    for number, witness in enumerate(kinds, 1):  # witness.json, witness-2.json, ...
        name = f"{out.witness.stem}-{number}{out.witness.suffix}" if number > 1 else out.witness.name
        _keep(context, case_path, bound, witness, out.witness.with_name(name))
    _write_margins(context, margins, out.margins, record)
    write_json(out.counts, content | {"witnesses": [w.what for w in witnesses]})
    log.info("%s", _summary(content))
    tolerated = noise is None and tolerated_share(context.case) > 0
    if loops[DISTURBANCE].violations or (content["violations"] and not tolerated):
        _break(content, found, kinds, out.witness)


def _break(content: Mapping[str, Any], found: SearchRecord, kinds: Sequence[Witness], witness: Path) -> Never:
    beside = f", and {len(kinds) - 1} of other kinds beside it" if len(kinds) > 1 else ""
    remedy = "The bound held: the fault is in the abstraction or in the specification."
    if found.violations:
        remedy = "The bound does not cover the simulator: use a smaller eps, or longer histories."
    raise BrokenPromise(
        f"the adversary broke it: {_summary(content)}; the first: {kinds[0].what}",
        f"`simgap replay {witness}` shows it{beside}. {remedy}",
    )


def _write_margins(context: Context, margins: Margins | str, path: Path, record: Mapping[str, Any]) -> None:
    """A row a cell; none where there are no margins."""
    columns: dict[str, Any] = {"factor": np.empty(0, np.float32)}
    if not isinstance(margins, str):
        columns = {"factor": margins.factor, "loses_by": margins.loses_by}
    write_parquet(path, table(columns, {}, {"case": context.case.name}, record))


def _shared(
    context: Context, gap: GapFunction, controller: Path, folder: Path
) -> tuple[Mapped[Solution], WorstStarts, Margins | str]:
    """Read the controller, look at all of its cells once, and leave its tables in a folder."""
    solution = load_controller_of(controller, context).solution
    margins = margins_of(context, gap, solution)
    factor = None if isinstance(margins, str) else np.where(margins.factor >= 1.0, margins.factor, np.nan)
    return Mapped.of(solution, folder / "solution"), WorstStarts(solution, factor), margins


def _known(context: Context, bound: SavedGap, inputs: AuditFiles) -> tuple[Any, ...]:
    """Steps or histories from which searches over the gap begin."""
    hidden = context.case.hidden_state
    tables = [read_samples(context, path, "rollouts", "borders") for path in inputs.rollouts]
    tables.append(read_samples(context, inputs.fresh, "fresh"))
    if hidden is None:
        return worst_steps(context, bound.function, tables)
    return (worst_histories(context, bound.function, motion_of(context), tables, hidden.length),)


def counts(
    found: SearchRecord, loops: Mapping[str, Campaign], states: Sequence[str], noise: NoiseStatement | None = None
) -> dict[str, Any]:
    """Counts of what was tried and found, as plain data; steps outside gamma that `noise` leaves out are no violations.

    With noise the share outside is judged in closed loop. A search returns to states that drew badly, with the same
    draw, so that its share says nothing of chance; fresh samples judge single steps.
    """
    worst, broken = found.worst, found.violations
    outside, steps = loops[SIMULATOR].outside_gamma, loops[SIMULATOR].steps
    if noise is not None:
        broken = outside if noise.is_contradicted(steps, outside) else 0
    return {
        "evaluations": found.evaluations,
        "steps": loops[SIMULATOR].steps,
        "violations": broken + sum(loop.violations for loop in loops.values()),
        "gap": {
            "violations": found.violations,
            "evaluations_by_search": found.by,
            "largest_share": None if worst is None else worst.share,
            "worst": None if worst is None else dict(zip(states, worst.x.tolist(), strict=True)),
        },
        "closed_loop": {name: loop.to_json() for name, loop in loops.items()},
    }


def _summary(content: Mapping[str, Any]) -> str:
    loops = content["closed_loop"]
    return (
        f"{content['gap']['violations']:,} of {content['evaluations']:,} chosen evaluations lie outside gamma, "
        + " and ".join(
            f"{loops[name]['violations']:,} of {loops[name]['runs']:,} runs ({loops[name]['steps']:,} steps) {where} "
            "break the promise"
            for name, where in ((SIMULATOR, "in the simulator"), (DISTURBANCE, "against the worst disturbance"))
        )
    )


def _witnesses(context: Context, found: SearchRecord, loops: Mapping[str, Campaign]) -> list[Witness]:
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


def _keep(context: Context, case_path: Path, bound: SavedGap, witness: Witness, out: Path) -> None:
    """The witness with its case, from where it lies, and its bound."""
    where = os.path.relpath(reading.real(case_path), reading.real(out).parent)
    record = context.record("audit", rests=CONTROLLED)
    write_json(out, witness.to_json() | {"case": where, "gap": bound.content, "provenance": record})
