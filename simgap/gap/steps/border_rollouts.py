"""Roll-outs on borders and beside switching surfaces, for step `borders`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgap.config.case import Case
from simgap.gap.pairs import product
from simgap.gap.points import Columns
from simgap.gap.steps.tables import successor_columns
from simgap.geometry import Floats
from simgap.simulators.rollouts import roll_out_range


def roll_out_borders(case: Case, folder: Path, states: dict[str, Floats], inputs: Floats) -> tuple[Columns, str]:
    """Roll out each part's states (n, nx) with all inputs (M, nu), in the engine's process: the table, the engine."""
    x, u = product(np.concatenate(list(states.values())), inputs)
    following, spread, engine = roll_out_range(case, folder, x, u)
    return border_columns(case, states, inputs, following, spread), engine


def border_columns(
    case: Case, states: dict[str, Floats], inputs: Floats, following: Floats,
    spread: tuple[Floats, Floats] | None = None,
) -> Columns:  # fmt: skip
    """The table of roll-outs of the parts of `states` with all inputs: successors (n, nx)."""
    x, u = product(np.concatenate(list(states.values())), inputs)
    part = np.repeat(list(states), [len(own) * len(inputs) for own in states.values()])
    return {"part": part, **successor_columns(case, x, u, following, spread)}
