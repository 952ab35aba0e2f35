"""Stage `audit`: an adversary with a budget against the bound and the controller; one violation fails the run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.attack.campaign import Campaign
from simgap.attack.danger import Danger
from simgap.attack.known import worst_histories, worst_steps
from simgap.attack.share import Searched
from simgap.attack.starts import beginnings
from simgap.attack.witness import DISTURBANCE, SIMULATOR, Witness
from simgap.config.audit import AuditSection
from simgap.config.reads import CONTROLLED
from simgap.config.trials import Trials
from simgap.errors import BrokenPromise
from simgap.gap.function import GapFunction
from simgap.gap.steps.samples import motion_of
from simgap.io.controller_file import load_controller_of
from simgap.io.documents import write_json
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.parquet import table, write_parquet
from simgap.io.shared_solution import SharedSolution
from simgap.provenance import provenance
from simgap.simulators.process import engine_pool
from simgap.stages.attacks import Job, attack
from simgap.stages.context import Context, log
from simgap.stages.made import samples_of
from simgap.stages.margins import margins_of, summary
from simgap.stages.scratch import scratch
from simgap.stages.validation import tolerated
from simgap.synthesis.margins import Margins

TABLES = ".tables"  # folder beside the counts
PARTS = 2  # each with random numbers of its own, whatever the number of workers


@dataclass(frozen=True)
class Inputs:
    """Files that the audit reads: the bound, the gap-aware controller, its roll-outs and the fresh samples."""

    gap: Path
    controller: Path
    rollouts: Sequence[Path]
    fresh: Path


@dataclass(frozen=True)
class Outputs:
    """Files that it writes: the counts, the margins of every cell, and what breaks the promise, if anything does."""

    counts: Path
    margins: Path
    witness: Path


def run(
    case_path: Path,
    inputs: Inputs,
    out: Outputs,
    workers: int = 2,
    engine_log: Path | None = None,
    trials: Trials = Trials.PLAIN,
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
    with scratch(out.counts.parent / TABLES) as folder:
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
    if loops[DISTURBANCE].violations or (content["violations"] and not tolerated(context.case)):
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


def _done(pool: ProcessPoolExecutor, jobs: list[Job]) -> list[tuple[Searched, dict[str, Campaign]]]:
    return [job.result() for job in [pool.submit(attack, job) for job in jobs]]


@dataclass(frozen=True, eq=False)
class _Ground:
    """What all parts begin from: the solution, and what makes its cells narrow."""

    solution: SharedSolution
    danger: Danger
    beginnings: Any
    margin: Any


def _shared(context: Context, gap: GapFunction, controller: Path, scratch: Path) -> tuple[_Ground, Margins | str]:
    """Read the controller, look at all of its cells once, and leave its tables in a folder."""
    solution = load_controller_of(controller, context).solution
    margins = margins_of(context, gap, solution)
    factor = None if isinstance(margins, str) else margins.factor
    shared = SharedSolution.of(solution, scratch)
    return _Ground(shared, Danger.of(solution), beginnings(solution), factor), margins


def _known(context: Context, bound: SavedGap, inputs: Inputs) -> tuple[Any, ...]:
    """Where searches over the gap begin."""
    hidden = context.case.hidden_state
    tables = [samples_of(context, path, "rollouts", "borders") for path in inputs.rollouts]
    tables.append(samples_of(context, inputs.fresh, "fresh"))
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
    """What was tried and what was found, as plain data."""
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
