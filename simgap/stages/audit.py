"""Stage `audit`: an adversary with a budget against the bound and the controller; one violation fails the run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.attack.campaign import Campaign
from simgap.attack.known import worst_histories, worst_steps
from simgap.attack.share import Searched
from simgap.attack.witness import DISTURBANCE, SIMULATOR, Witness
from simgap.config.audit import AuditSection
from simgap.errors import BrokenPromise
from simgap.gap.function import GapFunction
from simgap.gap.steps.samples import motion_of
from simgap.geometry import Floats
from simgap.io.controller_file import load_controller
from simgap.io.documents import write_json
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.parquet import table, write_parquet
from simgap.io.samples import read_columns
from simgap.provenance import provenance
from simgap.simulators.process import engine_pool
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.stages.attacks import Job, attack
from simgap.stages.context import Context, log
from simgap.stages.validation import tolerated
from simgap.synthesis.margins import LARGEST_FACTOR, Margins, one_step_margins

PARTS = 2  # each with random numbers of its own, whatever the number of workers
SHARES = (0.0, 0.05, 0.5)  # quantiles of the margins that are printed


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
    case_path: Path, inputs: Inputs, out: Outputs, workers: int = 2, engine_log: Path | None = None, times: int = 1
) -> None:
    """Attack with `times` the budget of the case, count, and write what was found.

    Raises:
        BrokenPromise: one broken run, whatever the case tolerates; one step of the simulator outside gamma, unless it
            tolerates a share of them.
    """
    context = Context.load(case_path)
    section = context.case.audit or AuditSection()
    out.witness.unlink(missing_ok=True)
    with context.blame():
        bound = load_gap(inputs.gap, context)
        solution = load_controller(inputs.controller).solution
        margins = _margins(context, bound.function, solution)
        jobs = _jobs(context, section, bound, inputs, margins, times)
    with engine_pool(workers, engine_log) as pool:
        parts = _done(pool, jobs)
    found = Searched.joined([part for part, _ in parts])
    loops = {name: Campaign.joined([own[name] for _, own in parts]) for name in (SIMULATOR, DISTURBANCE)}
    record = provenance("audit", context.case, context.folder, {"audit": section.seed})
    witnesses = _witnesses(context, found, loops)
    content = counts(found, loops, context.states) | {"margins": summary(context, margins), "provenance": record}
    if witnesses:
        _keep(context, case_path, bound, witnesses[0], out.witness)
    _write_margins(context, margins, out.margins, record)
    write_json(out.counts, content | {"witnesses": [w.what for w in witnesses]})
    log.info("%s", _said(content))
    if loops[DISTURBANCE].violations or (content["violations"] and not tolerated(context.case)):
        raise BrokenPromise(
            f"the adversary broke it: {_said(content)}; the first: {witnesses[0].what}",
            f"`simgap replay {out.witness}` shows it. {_remedy(found)}",
        )


def _write_margins(context: Context, margins: Margins | None, path: Path, record: Mapping[str, Any]) -> None:
    """A row a cell; none where there are no margins."""
    columns: dict[str, Any] = {"factor": np.empty(0, np.float32)}
    if margins is not None:
        columns = {"factor": margins.factor} | {f"extra_{n}": margins.extra[:, j] for j, n in enumerate(context.states)}
    units = {f"extra_{n}": context.units[n] for n in context.states}
    write_parquet(path, table(columns, units, {"case": context.case.name}, record))


def _remedy(found: Searched) -> str:
    if found.violations:
        return "The bound does not cover the simulator: use a smaller eps, or longer histories."
    return "The bound held: the fault is in the abstraction or in the specification."


def _done(pool: ProcessPoolExecutor, jobs: list[Job]) -> list[tuple[Searched, dict[str, Campaign]]]:
    return [job.result() for job in [pool.submit(attack, job) for job in jobs]]


def _jobs(
    context: Context, section: AuditSection, bound: SavedGap, inputs: Inputs, margins: Margins | None, times: int
) -> list[Job]:
    """The parts; what is known goes to them in turns."""
    hidden = context.case.hidden_state
    evaluations, steps = (times * n for n in section.budget(hidden is not None))
    tables = [read_columns(path) for path in (*inputs.rollouts, inputs.fresh)]
    known: tuple[Any, ...] = (
        (worst_histories(context, bound.function, motion_of(context), tables, hidden.length),)
        if hidden is not None
        else worst_steps(context, bound.function, tables)
    )
    factor = None if margins is None else margins.factor
    return [
        Job(
            case=context.case,
            path=context.path,
            gap=bound.content,
            seed=(section.seed, part),
            controller=inputs.controller,
            margin=factor,
            evaluations=-(-evaluations // PARTS),
            steps=-(-steps // PARTS),
            known=tuple(a[part::PARTS] for a in known),
        )
        for part in range(PARTS)
    ]


def _margins(context: Context, gap: GapFunction, solution: Solution) -> Margins | None:
    """None where cells alone do not say what the controller may do.

    That is so where it remembers an input, and where it keeps cells of the true state by inputs of the measured one.
    """
    if solution.memory > 1:
        return None
    space, sensing = Space.of(context.case), context.case.sensing
    error: Floats | None = space.vector(sensing.error) if sensing else None
    if solution.value is None and error is not None and np.any(error > 0):
        return None
    inside, mask = solution.winning if solution.value is None else solution.value >= 0, solution.mask
    axes = [j for j in range(space.size) if j not in gap.domain.free]
    model = context.plant.sampled
    return one_step_margins(model, solution.grid, context.input_set, gap.kernel(), inside, mask, axes, error)


def summary(context: Context, margins: Margins | None) -> dict[str, Any] | None:
    """Least, 5 % and median margin over the cells that have one, and how many cells that is."""
    if margins is None:
        return None
    known = np.isfinite(margins.factor)
    if not known.any():
        return None

    def quantiles(values: Any) -> dict[str, float]:
        named = zip(("least", "five_percent", "median"), np.quantile(values, SHARES, method="lower"), strict=True)
        return {name: float(v) for name, v in named}

    return {
        "cells": int(known.sum()),
        "factor": quantiles(margins.factor[known]),
        "largest_looked_for": LARGEST_FACTOR,
        "extra": {n: quantiles(margins.extra[known, j]) for j, n in enumerate(context.states)},
    }


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
    out = [Witness.of_step(step) for step in found.outside]
    for name, loop in loops.items():
        out += [Witness.of_run(name, broken, context.input_set) for broken in loop.broken]
    return out


def _keep(context: Context, case_path: Path, bound: SavedGap, witness: Witness, out: Path) -> None:
    """The witness with its case, from where it lies, and its bound."""
    where = os.path.relpath(case_path.resolve(), out.resolve().parent)
    record = provenance("audit", context.case, context.folder)
    write_json(out, witness.to_json() | {"case": where, "gap": bound.content, "provenance": record})
