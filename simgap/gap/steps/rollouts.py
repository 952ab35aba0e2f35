"""Step `rollouts`: the simulator on one shard of the grid, in the engine's own process.

The nominal model is not evaluated here but where the gap is formed: a change of the nominal model then reuses every
roll-out, and that is what a corrected model is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.gap.pairs import product
from simgap.gap.points import Columns, Points, cut, remembers
from simgap.gap.steps.histories import EXTENTS, history_shard
from simgap.geometry import Floats
from simgap.simulators.rollouts import Range, roll_out_range

KINDS = ("next", "least", "largest")


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


def successor_columns(
    case: Case, x: Floats, u: Floats, following: Floats, spread: Range | None = None
) -> dict[str, Floats]:
    """States, inputs, successors `next_<state>`; `least_` and `largest_` where they have a range."""
    states, inputs = list(case.plant.states), list(case.plant.inputs)
    columns = {n: x[:, k] for k, n in enumerate(states)} | {n: u[:, k] for k, n in enumerate(inputs)}
    columns |= {f"next_{n}": following[:, k] for k, n in enumerate(states)}
    for kind, values in zip(KINDS[1:], spread or (), strict=False):
        columns |= {f"{kind}_{n}": values[:, k] for k, n in enumerate(states)}
    return columns


def units(case: Case) -> Mapping[str, str]:
    """Units of all columns that this step and `fresh` write."""
    plant = case.plant
    own = {n: s.unit for n, s in plant.states.items()}
    of_states = {f"{kind}_{n}": unit for kind in (*KINDS, "moved") for n, unit in own.items()}
    of_inputs = {n: i.unit for n, i in plant.inputs.items()}
    return own | of_inputs | of_states | dict.fromkeys(EXTENTS, "m") | {"heading": "rad"}
