"""Closed loop of a robot among obstacles: the part of stage `validation` for reach-while-avoid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from simgap.arena import COLLIDED, LATE, REACHED, STUCK, Arena, Drive, drive, wrapped
from simgap.audit import Tally, audit_gap
from simgap.closed_loop import Run, batch_loop, scalar_lookup
from simgap.config.case import Case
from simgap.config.pose import pose_axes
from simgap.config.synthesis import ReachAvoidSpecification
from simgap.errors import UserError
from simgap.gap.function import GapFunction
from simgap.geometry import Floats
from simgap.io.controller_file import load_controller
from simgap.io.documents import write_json
from simgap.io.gap_file import load_gap
from simgap.io.parquet import write_parquet
from simgap.model.sampled import NominalModel
from simgap.plants.cases import nominal_model
from simgap.provenance import provenance
from simgap.simulators.process import engine_pool
from simgap.stages.context import Context, log
from simgap.stages.starts import starts
from simgap.stages.validation import Subject, keep_promise, keep_some, trace
from simgap.synthesis.controller import Controller

CHUNK = 25


@dataclass(frozen=True, eq=False)
class Values:
    """The value function in the shape of a policy, so that one look-up serves both."""

    grid: Any
    choice: Any
    input_set: Floats
    memory: int = 1


def run(
    context: Context,
    paths: Mapping[str, Path],
    gap_path: Path,
    out: Path,
    traces: Path,
    workers: int,
    engine_log: Path | None,
) -> None:
    """Drive every start of each winning domain to the target, audit every step, keep a few traces.

    Raises:
        BrokenPromise: if a gap-aware run does not reach the target, touches anything, or leaves gamma.
    """
    section = context.need(context.case.validation, "validation")
    with context.blame():
        model, gap, arena = (
            nominal_model(context.case, context.folder),
            load_gap(gap_path, context).function,
            arena_of(context),
        )
    tallies: dict[str, dict[str, Any]] = {}
    parts: list[pa.Table] = []
    for kind, path in paths.items():
        controller = load_controller(path)
        with context.blame():
            begin = starts(context, section, controller)
        driven = _simulate(context, path, begin, section.steps, arena, workers, engine_log)
        for plant, runs in (
            ("simulator", driven),
            ("nominal model", _on_model(context, model, controller, arena, begin, section.steps)),
        ):
            figures, kept = _judge(context, runs, controller, model, gap, section.kept)
            tallies.setdefault(kind, {})[plant] = figures
            log.info("%s controller, %s: %s", kind, plant, {k: v for k, v in figures.items() if k != "steps_to_target"})
            for number, d in enumerate(kept):
                r = Run(d.x, d.inputs, False)
                safe = np.arange(len(d.x)) < len(d.x) - (d.clearance <= 0.0)
                parts.append(trace(context, Subject(kind, plant), number, r, controller, model, gap, safe))
    write_parquet(traces, pa.concat_tables(parts).unify_dictionaries())
    record = provenance("validation", context.case, context.folder, {"starts": section.seed})
    write_json(out, {"starts": section.starts, "steps": section.steps, "controllers": tallies, "provenance": record})
    keep_promise(tallies["gap"]["simulator"])


def arena_of(context: Context) -> Arena:
    """Obstacles and walls in the plane, and the footprint's radius: the clearance that the case asks for.

    Raises:
        UserError: a specification that is not about the plane.
    """
    specification = context.need(context.case.synthesis, "synthesis").specification
    i, j, _ = pose_axes(context)
    x, y = context.states[i], context.states[j]
    if not isinstance(specification, ReachAvoidSpecification):
        raise UserError("a robot among obstacles needs a reach_avoid specification", key="synthesis.specification")
    boxes = [[*b.get(x, (-np.inf, np.inf)), *b.get(y, (-np.inf, np.inf))] for b in specification.obstacles]
    walls = [*specification.arena.get(x, context.domain.X[x]), *specification.arena.get(y, context.domain.X[y])]
    radius = min(specification.clearance.get(x, 0.0), specification.clearance.get(y, 0.0))
    return Arena(np.array(boxes).reshape(-1, 4), np.array(walls), radius)


def drive_chunk(
    case: Case, folder: Path, path: Path, starts: Floats, steps: int, arena: Arena, position: tuple[int, int]
) -> list[Drive]:
    """Run in an engine's process."""
    from simgap.simulators.build import make_simulator

    controller, simulator = load_controller(path), make_simulator(case, folder)
    value = value_function(controller)
    try:
        return [drive(simulator, controller, value, arena, x, steps, position) for x in starts]  # type: ignore[arg-type]
    finally:
        simulator.close()


def value_function(controller: Controller) -> Any:
    """Worst-case steps to the target at one state, negative where losing."""
    found = scalar_lookup(Values(controller.grid, controller.solution.value, controller.input_set))  # type: ignore[arg-type]
    return lambda x: found(x, 0)


def _simulate(
    context: Context, path: Path, starts: Floats, steps: int, arena: Arena, workers: int, engine_log: Path | None
) -> Iterator[Drive]:
    position = pose_axes(context)[:2]
    with engine_pool(workers, engine_log) as pool:
        jobs = [
            pool.submit(drive_chunk, context.case, context.folder, path, starts[k : k + CHUNK], steps, arena, position)
            for k in range(0, len(starts), CHUNK)
        ]
        for k, job in enumerate(jobs):
            yield from job.result()
            if (k + 1) % 10 == 0 or k + 1 == len(jobs):
                log.info("drove %d of %d runs", min((k + 1) * CHUNK, len(starts)), len(starts))


def _on_model(
    context: Context, model: NominalModel, controller: Controller, arena: Arena, starts: Floats, steps: int
) -> Iterator[Drive]:
    """The same starts on the nominal model; between samples its way is the straight line."""
    columns = list(pose_axes(context)[:2])
    value = value_function(controller)
    for r in batch_loop(model.step, controller, starts, steps, lambda x: ~controller.in_target(x)):
        share = np.linspace(0.0, 1.0, 21)[:, None]
        at = r.x[:, columns]
        ways = [a + share * (b - a) for a, b in pairwise(at)]
        near = [arena.clearance(way) for way in ways] or [arena.clearance(at)]
        hit = next((k for k, c in enumerate(near) if c <= 0.0), None)
        last = len(r.x) if hit is None else hit + 2
        levels = [value(x) for x in r.x[:last]]
        climbs = sum(not 0 <= b < a for a, b in pairwise(levels))
        ends = ((hit is not None, COLLIDED), (levels[-1] == 0, REACHED), (r.stuck, STUCK), (True, LATE))
        end = next(name for holds, name in ends if holds)
        yield Drive(r.x[:last], r.inputs[: last - 1], end, min(near[: last - 1] or near), climbs)


def _judge(
    context: Context, runs: Iterator[Drive], controller: Controller, model: NominalModel, gap: GapFunction, keep: int
) -> tuple[dict[str, Any], list[Drive]]:
    tally = Tally()
    kept: list[tuple[Drive, bool]] = []
    steps: list[int] = []
    climbs, nearest = 0, np.inf
    axis = pose_axes(context)[2]
    ends = context.domain.X[context.states[axis]]
    for d in runs:
        x, following = wrapped(d.x[:-1], d.x[1:], axis, *ends)
        outside = int(audit_gap(x, controller.input_set[d.inputs], following, model, gap).outside.sum())
        reached = d.end == REACHED
        tally.add(d.end, reached, len(d.inputs), outside)
        keep_some(kept, d, keep, not reached)
        steps += [len(d.inputs)] if reached else []
        climbs += d.climbs
        nearest = min(nearest, d.clearance)
    figures = tally.to_json() | {
        "steps_to_target": steps,
        "steps_that_left_the_certified_box": climbs,
        "least_clearance": nearest,
    }
    return figures, [d for d, _ in kept]
