"""Stage `rollouts`: the simulator on one shard of the grid."""

from __future__ import annotations

from pathlib import Path

from simgap.gap.points import shard_count
from simgap.gap.steps.rollouts import roll_out_shard
from simgap.gap.steps.tables import units
from simgap.io.samples import write_columns
from simgap.provenance import provenance
from simgap.simulators.process import run_in_processes
from simgap.stages.context import Context, log
from simgap.stages.made import points_of_case


def run(case_path: Path, grid: Path, shard: int, out: Path, engine_log: Path | None = None) -> None:
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
    record = provenance("rollouts", context.case, context.folder, seeds, engine=engine)
    constants = {"case": context.case.name, "point": points.name, "engine": engine}
    write_columns(out, columns, units(context.case), constants, record)
    log.info("wrote %d roll-outs to %s", len(next(iter(columns.values()))), out)
