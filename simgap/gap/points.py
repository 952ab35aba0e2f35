"""Points at which a case's gap is taken: a radius of the balls that cover X, or a grid of the inputs before.

The name of a point is that of its folder: `eps~0.0022`, `hidden-state`, `full-table`. A simulator that remembers
earlier inputs is not a function of X and U: its gap is taken over histories, seen from the robot, not over a grid of X.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.config.case import Case
from simgap.config.grid import GridSection
from simgap.errors import UserError
from simgap.geometry import Floats

HISTORIES = "hidden-state"
EVERY_HISTORY = "full-table"
_COVERING = "eps~"

Columns = Mapping[str, NDArray[Any]]
"""A table of samples: columns by name."""


@dataclass(frozen=True, eq=False)
class Points:
    """Where the simulator is asked: every state (or earlier input) with every input.

    Attributes:
        name: of the point. states: (N, nx), or (P, nu) previous inputs where these are the hidden state.
        inputs: (M, nu).
    """

    name: str
    states: Floats
    inputs: Floats


def remembers(case: Case) -> bool:
    """Whether the simulator's state is larger than x, so that its gap is taken over histories."""
    return case.hidden_state is not None


def own_point(case: Case) -> str:
    """The point that the case itself names.

    Raises:
        UserError: a case without the section that names it.
    """
    if remembers(case):
        return HISTORIES
    if case.grid is None:
        raise UserError("this stage needs the section", key="grid", remedy="Add `grid:`.")
    return covering_point(case.grid.eps)


def points_of(case: Case, radii: Iterable[float] = ()) -> list[str]:
    """The case's own point and those of a sweep over `radii`, coarsest first; a case with histories has no others."""
    if remembers(case) or case.grid is None:
        return [own_point(case)]
    return [covering_point(eps) for eps in sorted({case.grid.eps, *radii}, reverse=True)]


def covering_point(eps: float) -> str:
    """The point of a covering by balls of radius eps."""
    return f"{_COVERING}{eps:g}"


def radius(name: str) -> float:
    """eps of a covering point.

    Raises:
        UserError: another kind of point, or no positive number.
    """
    try:
        eps = float(name.removeprefix(_COVERING)) if name.startswith(_COVERING) else -1.0
    except ValueError:
        eps = -1.0
    if not (eps > 0 and np.isfinite(eps)):
        raise UserError(f"'{name[:40]}' is no point of this case", remedy="Use eps~ and a radius, such as eps~0.01.")
    return eps


def shard_count(case: Case) -> int:
    """Files that the roll-outs are cut into."""
    return case.grid.shards if case.grid is not None else int(GridSection.model_fields["shards"].default)


def state_names(case: Case) -> list[str]:
    """Names of the columns of `Points.states`."""
    if remembers(case):
        return [f"previous_{name}" for name in case.plant.inputs]
    return list(case.plant.states)


def cut(count: int, shard: int, shards: int) -> slice:
    """Rows of one shard out of `count`: consecutive, so that shards in order are all rows in order."""
    edges = np.linspace(0, count, shards + 1).astype(int)
    return slice(int(edges[shard]), int(edges[shard + 1]))
