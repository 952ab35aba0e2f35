"""Where the closed-loop runs begin: states given in the case first, the rest drawn from the winning domain.

Both controllers begin at the same states, so that what tells their runs apart is the controllers alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simgap.config.trials import Trials
from simgap.config.validation import ValidationSection
from simgap.errors import UserError
from simgap.geometry import Floats, points_of_cells
from simgap.io.traces import ROBUST
from simgap.stages.context import Context
from simgap.synthesis.controller import Controller


class Starts(NamedTuple):
    """States x (n, nx), and their numbers (n,): the same state has the same number for every controller."""

    x: Floats
    numbers: NDArray[np.int64]


def starts(context: Context, section: ValidationSection, controller: Controller, count: int) -> Floats:
    """`count` states of the winning domain, those of `validation.first` in front: (n, nx).

    Raises:
        UserError: a given start that does not name every state, or lies outside X or outside the winning domain.
    """
    given = [given_start(context, controller, number, named) for number, named in enumerate(section.first)]
    drawn = draw_starts(controller, max(count - len(given), 0), section.seed)
    return np.concatenate([np.array(given).reshape(-1, len(context.states)), drawn])


def starts_by_kind(
    context: Context,
    section: ValidationSection,
    robust: Controller,
    others: Mapping[str, Controller],
    trials: Trials = Trials.PLAIN,
) -> dict[str, Starts]:
    """Starts of the gap-aware controller, and the first of them that each of the others wins too.

    One that wins none of them begins in its own winning domain.

    Raises:
        UserError: as `starts` does.
    """
    own, most = starts(context, section, robust, section.count(trials)), section.baseline_count(trials)
    begin = {ROBUST: Starts(own, np.arange(len(own)))}
    for kind, other in others.items():
        shared = np.flatnonzero(other.contains(own))[:most]
        apart = starts(context, section, other, most) if not len(shared) else own[:0]
        begin[kind] = Starts(own[shared], shared) if len(shared) else Starts(apart, len(own) + np.arange(len(apart)))
    return begin


def given_start(context: Context, controller: Controller, number: int, named: dict[str, float]) -> Floats:
    """One start of the case as a state, (nx,)."""
    key = f"validation.first[{number}]"
    if sorted(named) != sorted(context.states):
        raise UserError(
            f"the start names {', '.join(named) or 'no state'}", key=key,
            remedy=f"Give a value for each of {', '.join(context.states)}.",
        )  # fmt: skip
    for name in context.states:
        lo, hi = context.domain.X[name]
        if not lo <= named[name] <= hi:
            raise UserError(
                f"the start lies outside X: {name} = {named[name]:g} is not in [{lo:g}, {hi:g}]", key=key,
                remedy="Move it inside, or enlarge domain.X.",
            )  # fmt: skip
    x = np.array([named[name] for name in context.states])
    if not controller.contains(x[None])[0]:
        raise UserError(
            f"the controller promises nothing from the start {named}: it is not in the winning domain", key=key,
            remedy="Move it away from obstacles and walls, or take it out.",
        )  # fmt: skip
    return x


def draw_starts(controller: Controller, count: int, seed: int) -> Floats:
    """Points of the winning domain: (count, nx); half of them inside a cell, the rest on its faces and its corners.

    Cells are drawn uniformly from those where a run does not end at once: a start in the target proves nothing.
    """
    rng = np.random.default_rng(seed)
    solution, grid = controller.solution, controller.grid
    ends = np.zeros(grid.size, np.bool_) if solution.target is None else solution.at_first(solution.target)
    moving = solution.winning & (~ends | solution.at_first(solution.served))
    cells = rng.choice(np.flatnonzero(moving), count)
    place = rng.uniform(-0.999, 0.999, (count, grid.box.size))
    corner = np.where(rng.integers(0, 2, place.shape), 1.0, -1.0)
    face = np.arange(grid.box.size) == rng.integers(0, grid.box.size, count)[:, None]
    where = rng.integers(0, 4, count)[:, None]  # 0 and 1: inside, 2: on one face, 3: at a corner
    return points_of_cells(grid, cells, np.where((where == 3) | ((where == 2) & face), corner, place))
