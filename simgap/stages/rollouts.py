"""Stage `rollouts`: the simulator on one shard of the grid."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.gap.memory.histories import history_shard
from simgap.gap.noise import draws_at
from simgap.gap.sampling.points import Columns, Points, cut, product, remembers, shard_count, successor_columns
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out_range
from simgap.stages import CasePath, Grid, Option, Out, log
from simgap.stages.gap_inputs import points_of_case, write_rollouts


def run(
    case_path: CasePath,
    out: Out,
    grid: Grid,
    shard: Annotated[int, Option("Which part of the grid.")] = 0,
    engine_log: Path | None = None,
) -> None:
    """Roll out one shard of the grid in folder `grid` and write it.

    Raises:
        UserError: a case without simulator, a shard that does not exist.
    """
    context = Context.load(case_path)
    with context.blame():
        points = points_of_case(context, grid)
        log.info("%s, %d x %d samples in all", points.name, len(points.states), len(points.inputs))
        job = (context.case, context.folder, points, shard, shard_count(context.case))
        ((columns, engine),) = run_in_processes(roll_out_shard, [job], log=engine_log)
    hidden = context.case.hidden_state
    seeds = {"histories": hidden.seed} if hidden else {}
    write_rollouts(context, out, "rollouts", columns, engine, seeds, point=points.name)
    log.info("wrote %d roll-outs to %s", len(next(iter(columns.values()))), out)


def roll_out_shard(case: Case, folder: Path, points: Points, shard: int, shards: int) -> tuple[Columns, str]:
    """One shard as a table, and the engine's name.

    Raises:
        UserError: a shard that does not exist, a case without symmetry, or another kind of simulator.
    """
    if not 0 <= shard < shards:
        raise UserError(f"there is no shard {shard}", key="grid.shards", remedy=f"It is 0..{shards - 1}.")
    if remembers(case):
        return history_shard(case, folder, points, shard, shards)
    x, u = product(points.states[cut(len(points.states), shard, shards)], points.inputs)
    draws = draws_at(case, len(points.states) * len(points.inputs))
    following, spread, engine = roll_out_range(case, folder, x, u, draws)
    return successor_columns(case, x, u, following, spread), engine
