"""Stage `fresh`: random samples off the grid that no fit sees; gamma is checked on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgap.config.gap import HiddenStateSection
from simgap.gap.memory.histories import fresh_sequences
from simgap.gap.sampling.points import draw, step_columns, successor_columns
from simgap.plants.context import Context
from simgap.simulators.body_samples import joined
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import along_sequences, roll_out
from simgap.stages import CasePath, Out, Workers, log
from simgap.stages.gap_inputs import write_rollouts


def run(case_path: CasePath, out: Out, engine_log: Path | None = None, workers: Workers = 2) -> None:
    """Roll out random pairs, uniform on X x U, and write them."""
    context = Context.load(case_path)
    if context.case.hidden_state is not None:
        _sequences(context, context.case.hidden_state, out, engine_log, workers)
        return
    section = context.need(context.case.gap, "gap")
    with context.blame():
        x, u = draw(context.box, context.input_set, section.fresh_samples, section.seed)
        parts = zip(np.array_split(x, workers), np.array_split(u, workers), strict=True)
        jobs = [(context.case, context.folder, a, b) for a, b in parts]
        results = run_in_processes(roll_out, jobs, workers, engine_log)
    following, engine = np.concatenate([successors for successors, _ in results]), results[0][1]
    columns = successor_columns(context.case, x, u, following)
    write_rollouts(context, out, "fresh", columns, engine, {"samples": section.seed}, seed=section.seed)
    log.info("wrote %d random samples to %s", len(x), out)


def _sequences(context: Context, hidden: HiddenStateSection, out: Path, engine_log: Path | None, workers: int) -> None:
    """A simulator with memory is checked along random input sequences."""
    inputs = context.input_set
    with context.blame():
        parts = fresh_sequences(inputs, hidden)
        jobs = [(context.case, context.folder, numbers, inputs, seed) for numbers, seed in parts]
        results = run_in_processes(along_sequences, jobs, workers, engine_log)
    samples, engine = joined([own for own, _ in results]), results[0][1]
    columns, seed = step_columns(context.case, inputs, samples), hidden.fresh_seed
    write_rollouts(context, out, "fresh", columns, engine, {"samples": seed}, seed=seed)
    log.info("wrote %d fresh steps to %s", len(samples.m), out)
