"""Stage `twin`: the simulator of a case compared with the engine that it stands for, on every sample of the run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
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


@dataclass(frozen=True)
class TwinFiles:
    """Files of samples: roll-outs on the grid, fresh ones, traces of the closed loop (or None)."""

    rollouts: Shards
    fresh: Annotated[Path, Option("Fresh samples.")]
    traces: Annotated[Path | None, Option("Traces that the validation kept (Parquet).")] = None


@dataclass(eq=False)
class Differences:
    """Steps compared so far: how many, and for each of nx states the largest |difference| with its x and u."""

    nx: int
    samples: int = 0
    largest: Floats = field(init=False)
    at: list[dict[str, list[float]]] = field(init=False)

    def __post_init__(self) -> None:
        self.largest, self.at = np.zeros(self.nx), [{} for _ in range(self.nx)]

    def add(self, x: Floats, u: Floats, difference: Floats) -> None:
        """Take further steps in: (n, nx), (n, nu), (n, nx)."""
        self.samples += len(x)
        for i in range(self.nx):
            k = int(np.argmax(np.abs(difference[:, i])))
            if not abs(difference[k, i]) <= self.largest[i] or not self.at[i]:
                self.largest[i] = abs(difference[k, i])
                self.at[i] = {"x": x[k].tolist(), "u": u[k].tolist()}


def run(case_path: CasePath, given: TwinFiles, out: Out, engine_log: Path | None = None) -> None:
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
            "grid": (_rows(context, path, "rollouts") for path in given.rollouts),
            "fresh": (_rows(context, path, "fresh") for path in (given.fresh,)),
            "closed_loop": _loops(context, given.traces) if given.traces is not None else iter(()),
        }
        found, counts, engine = Differences(len(context.states)), {}, section.of.engine
        for part, steps in parts.items():
            before = found.samples
            for x, u, following in steps:
                job = (other, context.folder, x, u)
                ((again, engine),) = run_in_processes(roll_out, [job], log=engine_log)
                found.add(x, u, following - again)
            counts[part] = found.samples - before
    _judge(context, section.tolerance, found, engine)
    largest = {
        name: {"difference": float(found.largest[i]), "unit": context.units[name], "at": found.at[i]}
        for i, name in enumerate(context.states)
    }
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


def _judge(context: Context, tolerance: dict[str, float], found: Differences, engine: str) -> None:
    words = ", ".join(f"{name} {found.largest[i]:.3g} {context.units[name]}" for i, name in enumerate(context.states))
    log.info("largest difference to %s over %d samples: %s", engine, found.samples, words)
    for i, name in enumerate(context.states):
        limit = tolerance.get(name)
        if not np.isfinite(found.largest[i]) or (limit is not None and found.largest[i] > limit):
            raise BrokenPromise(
                f"the twin is off {engine}: {name} by up to {found.largest[i]:.3g} (tolerated: {limit}) "
                f"at {found.at[i]}",
                "Correct simulator.equations, or raise twin.tolerance.",
            )
