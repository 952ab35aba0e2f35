"""The stages from the grid to the bound, called one after the other as the rules do."""

from pathlib import Path

from simgap.gap.points import own_point, shard_count
from simgap.gap.steps.tables import successor_columns, units
from simgap.io.samples import write_columns
from simgap.stages import gap, grid, lipschitz, rollouts, scp
from simgap.stages.context import Context


def roll_out(case: Path, folder: Path, point: str | None = None) -> list[Path]:
    """Grid and roll-outs of a case: -> its shards."""
    grid.run(case, point, folder / "grid")
    count = shard_count(Context.load(case).case)
    shards = [folder / f"shard-{k}.parquet" for k in range(count)]
    for k, shard in enumerate(shards):
        rollouts.run(case, folder / "grid", k, shard)
    return shards


def made_up(context: Context, path: Path, x, u, following, spread=None) -> Path:
    """Roll-outs that no simulator made."""
    constants = {"case": context.case.name, "point": own_point(context.case), "engine": "made up"}
    columns = successor_columns(context.case, x, u, following, spread)
    write_columns(path, columns, units(context.case), constants, {})
    return path


def bound(case: Path, folder: Path, shards: list[Path], fresh: Path, out: Path, calibration: Path | None = None):
    """Scenario programs, Lipschitz constants and the bound of a case whose roll-outs are there."""
    made = {}
    for name, stage in (("scp", scp), ("lipschitz", lipschitz)):
        made[name] = []
        for state in Context.load(case).states:
            made[name].append(folder / name / f"{state}.json")
            stage.run(case, state, folder / "grid", shards, made[name][-1])
    inputs = gap.Inputs(folder / "grid", shards, made["scp"], made["lipschitz"], fresh, calibration)
    gap.run(case, inputs, out, folder / "thinned.parquet")
