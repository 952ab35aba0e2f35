"""Points at which a case's gap is taken, and the columns of the tables of samples there.

A point is a radius of the balls that cover X, a number of cells along each axis, or a grid of previous inputs. Its name
is that of its folder: `eps~0.0022`, `cells~24-32`, `hidden-state`, `full-table`. A simulator that remembers earlier
inputs is not a function of X and U: its gap is taken over histories, seen from the robot, not over a grid of X.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.gap import GridSection
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.simulators.body_samples import BodySamples

HISTORIES = "hidden-state"
EVERY_HISTORY = "full-table"
_COVERING, _CELLS = "eps~", "cells~"

Columns = Mapping[str, NDArray[Any]]
"""A table of samples: columns by name."""
Step = Callable[[Floats, Floats], Floats]
"""A nominal map: (n, nx), (n, nu) -> (n, nx)."""


@dataclass(frozen=True, eq=False)
class Points:
    """The places of roll-outs: every state (or earlier input) with every input.

    Attributes:
        name: of the point. states: (N, nx), or (P, nu) previous inputs where these are the hidden state.
        inputs: (M, nu).
    """

    name: str
    states: Floats
    inputs: Floats


def remembers(case: Case) -> bool:
    """True if the simulator's state is larger than x, so that its gap is taken over histories."""
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
    if case.grid.eps is not None:
        return covering_point(case.grid.eps)
    if case.domain is None:
        raise UserError("this stage needs the section", key="domain", remedy="Add `domain:`.")
    counts = [_cells(case.domain.X[name], case.grid.half_widths.get(name)) for name in case.plant.states]
    return _CELLS + "-".join(map(str, counts))


def _cells(ends: tuple[float, float], half_width: float | None) -> int:
    return 1 if half_width is None else max(1, math.ceil((ends[1] - ends[0]) / (2.0 * half_width) * (1 - 1e-12)))


def free_axes(case: Case) -> tuple[int, ...]:
    """Axes of the states along which a translation is declared: the gap does not depend on them."""
    along = case.symmetry.along if case.symmetry is not None else ()
    return tuple(j for j, name in enumerate(case.plant.states) if name in along)


def covering_grid(case: Case, box: Box, name: str) -> Grid:
    """The cells of a point on X; one cell along the axes of a declared translation.

    Raises:
        UserError: another kind of point, or one of another case.
    """
    free = free_axes(case)
    if name.startswith(_CELLS):
        parts = name.removeprefix(_CELLS).split("-")
        if len(parts) != box.size or not all(part.isdecimal() and int(part) > 0 for part in parts):
            raise UserError(
                f"'{name[:40]}' is not a point of this case", remedy="Use cells~ and a count for each state."
            )
        counts = tuple(map(int, parts))
    else:
        counts = Grid.covering(box, radius(name)).cells
    return Grid(box, [1 if j in free else count for j, count in enumerate(counts)])


def points_of(case: Case, radii: Iterable[float] = ()) -> list[str]:
    """The case's own point and those of a sweep over `radii`, coarsest first; a case with histories has no others."""
    if remembers(case) or case.grid is None:
        return [own_point(case)]
    if case.grid.eps is None:
        return [*(covering_point(eps) for eps in sorted(set(radii), reverse=True)), own_point(case)]
    return [covering_point(eps) for eps in sorted({case.grid.eps, *radii}, reverse=True)]


def covering_point(eps: float) -> str:
    """The point of a covering by balls of radius eps."""
    return f"{_COVERING}{eps:g}"


def known_radius(name: str) -> float | None:
    """eps of a point, None for one of cells."""
    return None if name.startswith(_CELLS) else radius(name)


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
        raise UserError(f"'{name[:40]}' is not a point of this case", remedy="Use eps~ and a radius, such as eps~0.01.")
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


def product(x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """All pairs, the input running fastest: (n, nx), (M, nu) -> (n M, nx), (n M, nu)."""
    return np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))


def draw(box: Box, inputs: Floats, count: int, seed: int) -> tuple[Floats, Floats]:
    """`count` pairs, uniform on the box and on the input set (M, nu): (count, nx), (count, nu)."""
    rng = np.random.default_rng(seed)
    return box.sample(rng, count), inputs[rng.integers(0, len(inputs), count)]


KINDS = ("next", "least", "largest")
EXTENTS = ("least_x", "largest_x", "least_y", "largest_y")
AFTER_PREVIOUS, SEQUENCE, HISTORY = "after_previous", "sequence", "history"


def successor_columns(
    case: Case, x: Floats, u: Floats, following: Floats, spread: tuple[Floats, Floats] | None = None
) -> dict[str, Floats]:
    """States, inputs, successors `next_<state>`; `least_` and `largest_` where they have a range: (n,) each."""
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


def step_columns(case: Case, inputs: Floats, samples: BodySamples) -> dict[str, Any]:
    """Input, final pose `moved_<state>` and extent of each step from where it began: (n,) each; inputs are (M, nu)."""
    u = inputs[samples.m]
    columns: dict[str, Any] = {"input": samples.m, "previous": samples.previous}
    columns |= {n: u[:, j] for j, n in enumerate(case.plant.inputs)}
    columns |= {f"moved_{n}": samples.final[:, j] for j, n in enumerate(case.plant.states)}
    return columns | {n: samples.extent[:, j] for j, n in enumerate(EXTENTS)}


def body_samples(case: Case, columns: Columns, part: str | None = None) -> BodySamples:
    """The steps of one part of a table, or of all of it: the inverse of `step_columns`."""
    rows = slice(None) if part is None else columns["part"] == part
    final = np.stack([columns[f"moved_{n}"][rows] for n in case.plant.states], axis=-1)
    extent = np.stack([columns[n][rows] for n in EXTENTS], axis=-1)
    numbers = (columns[name][rows].astype(np.int64) for name in ("input", "previous"))
    return BodySamples(next(numbers), final, extent, next(numbers))


def stacked(columns: Columns, names: Sequence[str]) -> Floats:
    """Columns side by side: -> (rows, len(names))."""
    return np.stack([columns[name] for name in names], axis=-1)


def gap_ends(
    step: Step, rolled: Columns, states: Sequence[str], inputs: Sequence[str]
) -> tuple[Floats, Floats, Floats, Floats]:
    """States, inputs, least and largest gap of a table of roll-outs: (n, nx), (n, nu), (n, nx), (n, nx)."""
    x, u = stacked(rolled, states), stacked(rolled, inputs)
    predicted, ends = step(x, u), [successors(rolled, name) for name in states]
    lower, upper = (np.stack([pair[k] for pair in ends], axis=1) - predicted for k in (0, 1))
    return x, u, lower, upper


def successors(rolled: Columns, name: str) -> tuple[Floats, Floats]:
    """Least and largest successor of one state, (n,) each: one and the same array without memory of the inputs."""
    if f"least_{name}" not in rolled:
        return rolled[f"next_{name}"], rolled[f"next_{name}"]
    return rolled[f"least_{name}"], rolled[f"largest_{name}"]
