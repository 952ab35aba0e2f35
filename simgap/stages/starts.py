"""Where the closed-loop runs begin: states given in the case first, the rest drawn from the winning domain."""

from __future__ import annotations

import numpy as np

from simgap.config.validation import ValidationSection
from simgap.errors import UserError
from simgap.geometry import Floats
from simgap.stages.context import Context
from simgap.synthesis.controller import Controller


def starts(context: Context, section: ValidationSection, controller: Controller) -> Floats:
    """`validation.starts` states of the winning domain, those of `validation.first` in front: (n, nx).

    Raises:
        UserError: a given start that does not name every state, or lies outside X or outside the winning domain.
    """
    given = [given_start(context, controller, number, named) for number, named in enumerate(section.first)]
    drawn = draw_starts(controller, max(section.starts - len(given), 0), section.seed)
    return np.concatenate([np.array(given).reshape(-1, len(context.states)), drawn])


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
    """Points uniform on the winning domain: (count, nx)."""
    rng = np.random.default_rng(seed)
    cells = rng.choice(np.flatnonzero(controller.solution.winning), count)
    grid = controller.grid
    k = np.stack(np.unravel_index(cells, grid.cells), axis=-1)
    centres = grid.box.lo + grid.h * (2.0 * k + 1.0)
    return centres + grid.h * rng.uniform(-0.999, 0.999, centres.shape)
