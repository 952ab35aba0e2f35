"""Stage `twin`: the simulator of a case compared with the engine that it stands for, on every sample of the run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.gap.sampling.points import remembers, stacked
from simgap.io.results import write_json
from simgap.io.traces import SIMULATOR, split
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import CasePath, Option, Out, Shards, log
from simgap.stages.gap_inputs import read_samples, read_table

Steps = tuple[Floats, Floats, Floats]


def run(
    case_path: CasePath,
    rollouts: Shards,
    fresh: Annotated[Path, Option("Fresh samples.")],
    out: Out,
    traces: Annotated[Path | None, Option("Traces that the validation kept (Parquet).")] = None,
    engine_log: Path | None = None,
) -> None:
    """Take every sample again in the other engine, write and log the largest differences.

    Raises:
        UserError: a case without `twin`, or one whose simulator remembers.
        BrokenPromise: a difference above the tolerance of the case.
    """
    context = Context.load(case_path)
    section = context.need(context.case.twin, "twin")
    with context.blame():
        if remembers(context.case):
            raise UserError("a robot with memory has no twin", key="twin", remedy="Remove the section.")
        unknown = sorted(set(section.tolerance) - set(context.states))
        if unknown:
            raise UserError(f"{unknown} are not states", key="twin.tolerance", remedy=f"States: {context.states}.")
        other = context.case.model_copy(update={"simulator": section.of})
        parts = {
            "grid": (_rows(context, path, "rollouts") for path in rollouts),
            "fresh": (_rows(context, path, "fresh") for path in (fresh,)),
            "closed_loop": _loops(context, traces) if traces is not None else iter(()),
        }
        largest: dict[str, dict[str, Any]] = {
            name: {"difference": 0.0, "unit": context.units[name], "at": {}} for name in context.states
        }
        counts, engine = dict.fromkeys(parts, 0), section.of.engine
        for part, steps in parts.items():
            for x, u, following in steps:
                job = (other, context.folder, x, u)
                ((again, engine),) = run_in_processes(roll_out, [job], log=engine_log)
                counts[part] += len(x)
                for own, difference in zip(largest.values(), np.abs(following - again).T, strict=True):
                    k = int(np.argmax(difference))
                    if not difference[k] <= own["difference"] or not own["at"]:
                        own |= {"difference": float(difference[k]), "at": {"x": x[k].tolist(), "u": u[k].tolist()}}
    words = ", ".join(f"{name} {own['difference']:.3g} {own['unit']}" for name, own in largest.items())
    log.info("largest difference to %s over %d samples: %s", engine, sum(counts.values()), words)
    _judge(section.tolerance, largest, engine)
    content = {"engine": engine, "samples": counts, "largest": largest, "tolerance": section.tolerance}
    write_json(out, content | {"provenance": context.record("twin", engine=engine)})


def _rows(context: Context, path: Path, stage: str) -> Steps:
    columns = read_samples(context, path, stage)
    after = stacked(columns, [f"next_{name}" for name in context.states])
    return stacked(columns, context.states), stacked(columns, context.inputs), after


def _loops(context: Context, path: Path) -> Iterator[Steps]:
    """All steps that the validation kept of its runs in the simulator."""
    table = read_table(context, path, "validation")
    runs = [t for t in split(table, context.states, context.inputs) if t.plant == SIMULATOR]
    kept: list[Any] = [(t.x[:-1], t.u[:-1], t.x[1:]) for t in runs if len(t.x) > 1]
    if kept:
        x, u, after = (np.concatenate(column) for column in zip(*kept, strict=True))
        yield x, u, after


def _judge(tolerance: dict[str, float], largest: dict[str, dict[str, Any]], engine: str) -> None:
    for name, own in largest.items():
        limit, size = tolerance.get(name), own["difference"]
        if not np.isfinite(size) or (limit is not None and size > limit):
            raise BrokenPromise(
                f"the twin is off {engine}: {name} by up to {size:.3g} (tolerated: {limit}) at {own['at']}",
                "Correct simulator.equations, or raise twin.tolerance.",
            )
