"""Stage `rollouts`: the simulator on grid x inputs, one shard a call.

The nominal model is not evaluated here but where the gap is formed: a change of the nominal model then reuses every
roll-out, and that is what a corrected model is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.geometry import Floats, Grid
from simgap.io.parquet import stack, table, write_parquet
from simgap.provenance import provenance
from simgap.simulators.process import run_in_processes
from simgap.stages.context import Context, log

Range = tuple[Floats, Floats]
KINDS = ("next", "least", "largest")


def run(case_path: Path, eps: float, shard: int, out: Path, engine_log: Path | None = None) -> None:
    """Roll out one shard of the grid of radius `eps` and write it.

    Raises:
        UserError: a case without simulator, a shard that does not exist.
    """
    context = Context.load(case_path)
    shards = context.need(context.case.grid, "grid").shards
    if not 0 <= shard < shards:
        raise UserError(
            f"there is no shard {shard}", file=case_path, key="grid.shards", remedy=f"It is 0..{shards - 1}."
        )
    with context.blame():
        states = shard_of(Grid.covering(context.box, eps), shard, shards)
        x, u = product(states, context.input_set)
        log.info("%d states x %d inputs = %d roll-outs", len(states), len(x) // len(states), len(x))
        job = (context.case, context.folder, x, u)
        ((following, spread, engine),) = run_in_processes(roll_out_range, [job], log=engine_log)
    write(context, out, x, u, following, {"eps": eps, "seed": None, "engine": engine}, "rollouts", spread)
    log.info("wrote %s", out)


def shard_of(grid: Grid, shard: int, shards: int) -> Floats:
    """The states of one shard: consecutive cells, so that shards in order are the grid in order."""
    edges = np.linspace(0, grid.size, shards + 1).astype(int)
    return grid.centres()[edges[shard] : edges[shard + 1]]


def product(x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """All pairs, the input running fastest: (n, nx), (M, nu) -> (n M, nx), (n M, nu)."""
    return np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))


def roll_out(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, str]:
    """Run in the engine's process: successors and the engine's name."""
    from simgap.simulators.build import make_simulator

    simulator = make_simulator(case, folder)
    try:
        return simulator.rollouts(x, u), simulator.engine
    finally:
        simulator.close()


def roll_out_range(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, Range | None, str]:
    """`roll_out`, and the range of the successors where delayed or lagged inputs spread them."""
    from simgap.simulators.build import make_simulator

    simulator = make_simulator(case, folder)
    try:
        spread = simulator.spread(x, u) if simulator.remembers else None
        return simulator.rollouts(x, u), spread, simulator.engine
    finally:
        simulator.close()


def successors(context: Context, rolled: pa.Table) -> Range:
    """Least and largest successor of each row, (n, nx) each: one and the same without memory of the inputs."""
    if f"least_{context.states[0]}" not in rolled.column_names:
        following = stack(rolled, [f"next_{n}" for n in context.states])
        return following, following
    least, largest = (stack(rolled, [f"{end}_{n}" for n in context.states]) for end in ("least", "largest"))
    return least, largest


def write(
    context: Context,
    out: Path,
    x: Floats,
    u: Floats,
    following: Floats,
    constants: Mapping[str, object],
    stage: str,
    spread: Range | None = None,
) -> None:
    """One Parquet file: states, inputs, successors `next_<state>`; `least_` and `largest_` where they have a range."""
    columns = {n: x[:, k] for k, n in enumerate(context.states)}
    columns |= {n: u[:, k] for k, n in enumerate(context.inputs)}
    columns |= {f"next_{n}": following[:, k] for k, n in enumerate(context.states)}
    units = context.units | {f"{kind}_{n}": context.units[n] for kind in KINDS for n in context.states}
    for kind, values in zip(KINDS[1:], spread or (), strict=False):
        columns |= {f"{kind}_{n}": values[:, k] for k, n in enumerate(context.states)}
    seeds = {"samples": constants["seed"]} if isinstance(constants["seed"], int) else {}
    record = provenance(stage, context.case, context.folder, seeds, engine=constants["engine"])
    write_parquet(out, table(columns, units, {"case": context.case.name, **constants}, record))
