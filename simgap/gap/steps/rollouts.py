"""Step `rollouts`: the simulator on one shard of the grid, in the engine's own process.

The nominal model is not evaluated here but where the gap is formed: a change of the nominal model then reuses every
roll-out, and that is what a corrected model is.
"""

from __future__ import annotations

from pathlib import Path

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.gap.pairs import product
from simgap.gap.points import Columns, Points, cut, remembers
from simgap.gap.steps.histories import history_shard
from simgap.gap.steps.tables import successor_columns
from simgap.simulators.rollouts import roll_out_range


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
    following, spread, engine = roll_out_range(case, folder, x, u)
    return successor_columns(case, x, u, following, spread), engine
