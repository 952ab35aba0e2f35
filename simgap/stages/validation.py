"""Stage `validation`: both controllers in the simulator and on the nominal model; what they promise is counted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgap.arena import wrapped
from simgap.audit import Tally, audit_gap, judge_invariance, split_by_run, steps_of
from simgap.closed_loop import Run, Sensing, batch_loop, closed_loop
from simgap.config.case import Case
from simgap.config.synthesis import InvarianceSpecification, ReachAvoidSpecification
from simgap.errors import BrokenPromise
from simgap.gap.function import GapFunction
from simgap.geometry import Box, Floats
from simgap.io.controller_file import load_controller
from simgap.io.documents import write_json
from simgap.io.gap_file import load_gap
from simgap.io.parquet import table, write_parquet
from simgap.model.sampled import NominalModel
from simgap.plants.cases import nominal_model
from simgap.provenance import provenance
from simgap.simulators.process import engine_pool
from simgap.specifications.regions import partial_box
from simgap.stages.context import Context, log
from simgap.stages.starts import starts
from simgap.synthesis.controller import Controller

R = TypeVar("R")
CHUNK = 50  # runs a worker does between two signs of life


@dataclass(frozen=True)
class Subject:
    """One controller on one plant."""

    controller: str  # "gap" or "nominal"
    plant: str  # "simulator" or "nominal model"


def run(
    case_path: Path,
    nominal: Path,
    robust: Path,
    gap_path: Path,
    out: Path,
    traces: Path,
    workers: int = 2,
    engine_log: Path | None = None,
) -> None:
    """Run every start of each winning domain, audit every step, keep a few traces.

    Raises:
        BrokenPromise: if the gap-aware controller violates anything in the simulator.
    """
    context = Context.load(case_path)
    section = context.need(context.case.validation, "validation")
    if isinstance(context.need(context.case.synthesis, "synthesis").specification, ReachAvoidSpecification):
        from simgap.stages import drives

        drives.run(context, {"nominal": nominal, "gap": robust}, gap_path, out, traces, workers, engine_log)
        return
    with context.blame():
        model, gap = nominal_model(context.case, context.folder), load_gap(gap_path, context).function
        safe = safe_box(context)
    tallies: dict[str, dict[str, Any]] = {}
    parts: list[pa.Table] = []
    for kind, path in (("nominal", nominal), ("gap", robust)):
        controller = load_controller(path)
        with context.blame():
            begin = starts(context, section, controller)
        for subject, runs in _subjects(context, kind, controller, path, begin, model, safe, workers, engine_log):
            tally, kept = _judge(runs, controller, model, gap, safe, section.steps, section.kept)
            tallies.setdefault(kind, {})[subject.plant] = tally.to_json()
            log.info("%s controller, %s: %s", kind, subject.plant, tally.to_json())
            parts += [
                trace(context, subject, k, r, controller, model, gap, safe.contains(r.x)) for k, r in enumerate(kept)
            ]
    write_parquet(traces, pa.concat_tables(parts).unify_dictionaries())
    record = provenance("validation", context.case, context.folder, {"starts": section.seed})
    write_json(out, {"starts": section.starts, "steps": section.steps, "controllers": tallies, "provenance": record})
    keep_promise(tallies["gap"]["simulator"], context.case.gap.tolerated_probability if context.case.gap else 0.0)


def keep_promise(tally: dict[str, Any], tolerated: float = 0.0) -> None:
    """The gap-aware controller in the simulator must not violate anything; `tolerated` is the share of steps that may
    leave gamma where the case's bound promises no more.

    Raises:
        BrokenPromise: with the counts.
    """
    bad, outside = tally["runs_that_violated_it"], tally["steps_outside_gamma"]
    if bad or outside > tolerated * tally["steps"]:
        raise BrokenPromise(
            f"the gap-aware controller broke its promise: {bad} of {tally['runs']} runs violate the specification, "
            f"{outside} of {tally['steps']} steps are outside gamma",
            "The gap bound does not cover the simulator: look at the tiers in gap.json, use a smaller eps.",
        )


def safe_box(context: Context) -> Box:
    """The safe set of an invariance specification, within X."""
    specification = context.need(context.case.synthesis, "synthesis").specification
    named = specification.safe if isinstance(specification, InvarianceSpecification) else {}
    box = partial_box(named, tuple(context.states))
    return Box(np.maximum(box.lo, context.box.lo), np.minimum(box.hi, context.box.hi))


def _subjects(
    context: Context,
    kind: str,
    controller: Controller,
    path: Path,
    starts: Floats,
    model: NominalModel,
    safe: Box,
    workers: int,
    engine_log: Path | None,
) -> Iterator[tuple[Subject, Iterator[Run]]]:
    section = context.need(context.case.validation, "validation")
    runs = _simulate(context, path, starts, section.steps, safe, workers, engine_log)
    yield Subject(kind, "simulator"), runs
    red = batch_loop(model.step, controller, starts, section.steps, safe.contains)
    yield Subject(kind, "nominal model"), iter(red)


def _simulate(
    context: Context, path: Path, starts: Floats, steps: int, safe: Box, workers: int, engine_log: Path | None
) -> Iterator[Run]:
    """Runs in the order of their starts, a chunk a job."""
    chunks = [starts[k : k + CHUNK] for k in range(0, len(starts), CHUNK)]
    with engine_pool(workers, engine_log) as pool:
        jobs = [
            pool.submit(simulate_chunk, context.case, context.folder, path, part, steps, safe, k)
            for k, part in enumerate(chunks)
        ]
        for k, job in enumerate(jobs):
            yield from job.result()
            if (k + 1) % 5 == 0 or k + 1 == len(jobs):
                log.info("simulated %d of %d runs", min((k + 1) * CHUNK, len(starts)), len(starts))


def simulate_chunk(
    case: Case, folder: Path, path: Path, starts: Floats, steps: int, safe: Box, chunk: int
) -> list[Run]:
    """Run in an engine's process."""
    from simgap.simulators.build import make_simulator

    section = case.sensing
    error = np.array([section.error.get(n, 0.0) if section else 0.0 for n in case.plant.states])
    sensing = Sensing(error, section.latency if section else 0)
    controller, simulator = load_controller(path), make_simulator(case, folder)
    lo, hi = safe.lo.tolist(), safe.hi.tolist()
    axes = range(len(lo))

    def left(x: Floats) -> bool:
        return not all(lo[j] <= x[j] <= hi[j] for j in axes)

    rng = np.random.default_rng([chunk, case.validation.seed if case.validation else 0])
    try:
        return [
            closed_loop(simulator, controller, x, steps, sensing, rng, left, sensing.measure(x, rng)) for x in starts
        ]
    finally:
        simulator.close()


def _judge(
    runs: Iterator[Run], controller: Controller, model: NominalModel, gap: GapFunction, safe: Box, steps: int, keep: int
) -> tuple[Tally, list[Run]]:
    tally = Tally()
    kept: list[tuple[Run, bool]] = []
    batch: list[Run] = []

    def flush() -> None:
        x, u, following = steps_of(batch, controller.input_set)
        outside = split_by_run(audit_gap(x, u, following, model, gap).outside, batch)
        for r, count in zip(batch, outside, strict=True):
            tally.add(*judge_invariance(r, safe, steps), len(r.inputs), count)
        batch.clear()

    for r in runs:
        keep_some(kept, r, keep, failed=not judge_invariance(r, safe, steps)[1])
        batch.append(r)
        if len(batch) == 2 * CHUNK:
            flush()
    if batch:
        flush()
    return tally, [r for r, _ in kept]


def keep_some(kept: list[tuple[R, bool]], r: R, count: int, failed: bool) -> None:
    """Keep the first runs; the first that failed takes the last place if none of them did, so that it can be seen."""
    if len(kept) < count:
        kept.append((r, failed))
    elif failed and not any(bad for _, bad in kept):
        kept[-1] = (r, failed)


def trace(
    context: Context,
    subject: Subject,
    number: int,
    r: Run,
    controller: Controller,
    model: NominalModel,
    gap: GapFunction,
    safe: NDArray[np.bool_],
) -> pa.Table:
    """One kept run, a row a sample, `safe` (k + 1,) where the specification held.

    At the last state there is no input, and its cells are not numbers.
    """
    n = len(r.x)
    u = np.full((n, model.nu), np.nan)
    u[: n - 1] = controller.input_set[r.inputs]
    audit = audit_gap(*_unwound(context, r.x[:-1], r.x[1:], u[: n - 1]), model, gap)
    nan = np.full((1, model.nx), np.nan)
    d, lo, hi = (np.concatenate([part, nan]) for part in (audit.d, audit.lo, audit.hi))
    columns: dict[str, Any] = {"run": np.full(n, number), "step": np.arange(n), "sim_time": np.arange(n) * model.tau}
    columns |= {name: r.x[:, j] for j, name in enumerate(context.states)}
    columns |= {name: u[:, j] for j, name in enumerate(context.inputs)}
    for prefix, values in (("gap", d), ("lo", lo), ("hi", hi)):
        columns |= {f"{prefix}_{name}": values[:, j] for j, name in enumerate(context.states)}
    columns["safe"] = safe
    units = context.units | {"sim_time": "s"}
    units |= {f"{p}_{name}": context.units[name] for p in ("gap", "lo", "hi") for name in context.states}
    constants = {"case": context.case.name, "controller": subject.controller, "plant": subject.plant}
    return table(columns, units, constants, provenance("validation", context.case, context.folder))


def _unwound(context: Context, x: Floats, following: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Steps with every periodic state brought back into X, the successor moved by the same whole turns: x, u, x+."""
    for name in context.domain.periodic:
        j = context.states.index(name)
        x, following = wrapped(x, following, j, *context.domain.X[name])
    return x, u, following
