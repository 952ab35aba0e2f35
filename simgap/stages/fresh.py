"""Stage `fresh`: random samples off the grid that no fit sees; gamma is checked on them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgap.config.wheeled import HiddenStateSection
from simgap.geometry import Box, Floats
from simgap.simulators.process import run_in_processes
from simgap.stages.context import Context, log
from simgap.stages.rollouts import roll_out, write


def run(case_path: Path, out: Path, engine_log: Path | None = None, workers: int = 2) -> None:
    """Roll out random pairs, uniform on X x U, and write them."""
    context = Context.load(case_path)
    if context.case.hidden_state is not None:
        _sequences(context, context.case.hidden_state, out, engine_log, workers)
        return
    section = context.need(context.case.gap, "gap")
    random_samples(context, Draw("fresh", section.fresh_samples, section.seed), out, engine_log, workers)


@dataclass(frozen=True)
class Draw:
    """Random samples for a stage: how many, and the seed that is theirs alone."""

    stage: str
    count: int
    seed: int


def random_samples(context: Context, asked: Draw, out: Path, engine_log: Path | None, workers: int) -> None:
    """Roll out random pairs, uniform on X x U, and write them."""
    with context.blame():
        x, u = draw(context.box, context.input_set, asked.count, asked.seed)
        parts = zip(np.array_split(x, workers), np.array_split(u, workers), strict=True)
        jobs = [(context.case, context.folder, a, b) for a, b in parts]
        results = run_in_processes(roll_out, jobs, workers, engine_log)
    following = np.concatenate([successors for successors, _ in results])
    constants = {"eps": None, "seed": asked.seed, "engine": results[0][1]}
    write(context, out, x, u, following, constants, asked.stage)
    log.info("wrote %d random samples to %s", len(x), out)


def _sequences(context: Context, hidden: HiddenStateSection, out: Path, engine_log: Path | None, workers: int) -> None:
    """A simulator with memory is checked along random input sequences."""
    from simgap.stages.histories import fresh, write_samples

    with context.blame():
        samples, engine = fresh(context, hidden, workers, engine_log)
    write_samples(context, out, samples, hidden.fresh_seed, engine, "fresh")
    log.info("wrote %d fresh steps to %s", len(samples.m), out)


def draw(box: Box, inputs: Floats, count: int, seed: int) -> tuple[Floats, Floats]:
    """`count` pairs, uniform on the box and on the input set."""
    rng = np.random.default_rng(seed)
    return box.sample(rng, count), inputs[rng.integers(0, len(inputs), count)]
