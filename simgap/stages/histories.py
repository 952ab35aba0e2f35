"""Stage `histories`: what earlier inputs leave behind in a simulator whose state is larger than x.

Roll-outs after a grid of previous inputs, steps of random input sequences, and two small measurements: how fast the
influence of older inputs fades, and by how much equal histories differ between headings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap.config.wheeled import HiddenStateSection
from simgap.gap.hidden_state import fading, previous_inputs, random_sequences
from simgap.gap.symmetry import heading_deviation
from simgap.io.documents import write_json
from simgap.io.parquet import table, write_parquet
from simgap.provenance import provenance
from simgap.simulators.body_samples import BodySamples, joined
from simgap.simulators.process import engine_pool
from simgap.simulators.wheeled_rollouts import (
    after_previous,
    along_sequences,
    at_headings,
    with_longer_histories,
)
from simgap.stages.context import Context, log

EXTENTS = ("least_x", "largest_x", "least_y", "largest_y")


def run(
    case_path: Path,
    grid_out: Path,
    random_out: Path,
    memory_out: Path,
    workers: int,
    engine_log: Path | None,
    every: bool = False,
) -> None:
    """Sample histories in several engine processes and write them; `every`: all of U as previous inputs.

    Raises:
        UserError: a case without symmetry or hidden_state, or with another kind of simulator.
    """
    context = Context.load(case_path)
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    inputs, start = context.input_set, (context.case, context.folder)
    rng = np.random.default_rng(hidden.seed)
    with context.blame(), engine_pool(workers, engine_log) as pool:
        values = [context.domain.U[n].list() for n in context.inputs]
        counts = [len(own) for own in values] if every else [hidden.previous[n] for n in context.inputs]
        previous = previous_inputs(values, counts)
        sequences = random_sequences(inputs, hidden.chains, hidden.chain_length, rng)
        checked = random_sequences(inputs, symmetry.histories, hidden.length + 1, rng)
        grid = [pool.submit(after_previous, *start, p, inputs) for p in np.array_split(previous, 4 * workers)]
        chains = [
            pool.submit(along_sequences, *start, part, inputs, [hidden.seed, k])
            for k, part in enumerate(np.array_split(sequences, 2 * workers))
        ]
        longer = pool.submit(with_longer_histories, *start, checked, inputs)
        turned = pool.submit(at_headings, *start, checked, inputs, symmetry.headings, symmetry.seed)
        parts = []
        for k, job in enumerate(grid):
            parts.append(job.result())
            log.info("previous inputs: %d of %d parts", k + 1, len(grid))
        engine = parts[0][1]
        write_samples(context, grid_out, joined([p for p, _ in parts]), None, engine)
        write_samples(context, random_out, joined([job.result()[0] for job in chains]), hidden.seed, engine)
        memory, deviation = fading(longer.result()), heading_deviation(*turned.result())
    seeds = {"histories": hidden.seed, "headings": symmetry.seed}
    content = {
        "memory": memory,
        "largest_deviation": deviation.largest,
        "compared": deviation.samples,
        "previous_inputs": len(previous),
        "provenance": provenance("histories", context.case, context.folder, seeds, engine=engine),
    }
    write_json(memory_out, content)
    log.info("influence of older inputs %s; between headings %s", memory.tolist(), deviation.largest.tolist())


def fresh(
    context: Context, hidden: HiddenStateSection, workers: int, engine_log: Path | None
) -> tuple[BodySamples, str]:
    """Steps of random sequences with another seed, which no bound has seen."""
    inputs = context.input_set
    count = -(-hidden.fresh_samples // hidden.chain_length)
    rng = np.random.default_rng(hidden.fresh_seed)
    sequences = random_sequences(inputs, count, hidden.chain_length, rng)
    with engine_pool(workers, engine_log) as pool:
        jobs = [
            pool.submit(along_sequences, context.case, context.folder, part, inputs, [hidden.fresh_seed, k])
            for k, part in enumerate(np.array_split(sequences, 2 * workers))
        ]
        results = [job.result() for job in jobs]
    return joined([samples for samples, _ in results]), results[0][1]


def write_samples(
    context: Context, out: Path, samples: BodySamples, seed: int | None, engine: str, stage: str = "histories"
) -> None:
    """Inputs, final pose and extent of each step, seen from where it began."""
    columns: dict[str, Any] = {"input": samples.m}
    u = context.input_set[samples.m]
    columns |= {n: u[:, j] for j, n in enumerate(context.inputs)}
    columns |= {f"moved_{n}": samples.final[:, j] for j, n in enumerate(context.states)}
    columns |= {n: samples.extent[:, j] for j, n in enumerate(EXTENTS)}
    units = context.units | {f"moved_{n}": context.units[n] for n in context.states} | dict.fromkeys(EXTENTS, "m")
    seeds = {"samples": seed} if seed is not None else {}
    record = provenance(stage, context.case, context.folder, seeds, engine=engine)
    write_parquet(out, table(columns, units, {"case": context.case.name, "seed": seed, "engine": engine}, record))
