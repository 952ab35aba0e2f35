"""The stages from the grid to the bound, called one after the other as the rules do."""

from pathlib import Path

import numpy as np

from simgap.gap.sampling.borders import CHECK, FIT, border_columns, border_states
from simgap.gap.sampling.points import own_point, product, remembers, shard_count, successor_columns, units
from simgap.io.results import table, write_parquet
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.stages import borders, gap, grid, lipschitz, rollouts, scp


def roll_out(case: Path, folder: Path, point: str | None = None) -> list[Path]:
    """Grid and roll-outs of a case: -> its shards."""
    grid.run(case, point, folder / "grid")
    count = shard_count(Context.load(case).case)
    shards = [folder / f"shard-{k}.parquet" for k in range(count)]
    for k, shard in enumerate(shards):
        rollouts.run(case, shard, folder / "grid", k)
    return shards


def made_up(context: Context, path: Path, x, u, following, spread=None, stage="rollouts") -> Path:
    """Roll-outs or fresh samples that no simulator made."""
    constants = {"case": context.case.name, "point": own_point(context.case), "engine": "made up"}
    columns = successor_columns(context.case, x, u, following, spread)
    write_parquet(path, table(columns, units(context.case), constants, provenance(stage, context.case, context.folder)))
    return path


def made_up_borders(context: Context, path: Path, gap) -> Path:
    """Roll-outs on borders and beside switching surfaces whose gap is `gap(x, u)`."""
    point = own_point(context.case)
    states = {part: border_states(context, point, part).x for part in (FIT, CHECK)}
    x, u = product(np.concatenate([states[FIT], states[CHECK]]), context.input_set)
    following = context.plant.sampled.step(x, u) + gap(x, u)
    columns = border_columns(context.case, states, context.input_set, following)
    record = provenance("borders", context.case, context.folder)
    write_parquet(path, table(columns, units(context.case), {}, record))
    return path


def beside(case: Path, folder: Path) -> Path | None:
    """Samples on borders, if the gap of the case has any: those in the folder, else those of the simulator."""
    found = folder / "borders.parquet"
    if remembers(Context.load(case).case):
        return None
    if not found.exists():
        borders.run(case, None, found)
    return found


def bound(case: Path, folder: Path, shards: list[Path], fresh: Path, out: Path):
    """Scenario programs, Lipschitz constants and the bound of a case whose roll-outs are there."""
    made, on_borders = {}, beside(case, folder)
    for name, stage in (("scp", scp), ("lipschitz", lipschitz)):
        made[name] = folder / f"{name}.json"
        stage.run(case, folder / "grid", shards, made[name], *((on_borders,) if stage is scp else ()))
    inputs = (folder / "grid", shards, made["scp"], made["lipschitz"], fresh)
    gap.run(case, *inputs, out, folder / "thinned.parquet", on_borders)
