"""A grid of samples that is too coarse along a state for slopes: told before any roll-out."""

from __future__ import annotations

from simgap.errors import UserError
from simgap.gap.lipschitz.grid import FEWEST
from simgap.gap.sampling.points import covering_grid, free_axes, own_point
from simgap.plants.context import Context


def refuse_few_cells(context: Context) -> None:
    """Refuse fewer than `FEWEST` cells along a state on which the gap may depend.

    Raises:
        UserError: with the state and the key of the spacing.
    """
    case = context.case
    if case.simulator is None or case.grid is None or case.gap is None or case.hidden_state is not None:
        return
    cells, free = covering_grid(case, context.box, own_point(case)).cells, free_axes(case)
    for j, name in enumerate(context.states):
        if j in free or cells[j] >= FEWEST:
            continue
        width = float(context.box.hi[j] - context.box.lo[j]) / (2 * FEWEST)
        key = f"grid.half_widths.{name}" if case.grid.half_widths else "grid.eps"
        raise UserError(
            f"leaves {cells[j]} cell{'s' if cells[j] > 1 else ''} along {name}, too few to see how the gap changes",
            key=key, remedy=f"At most {width:.3g} there: {FEWEST} cells. A state on which the gap does not depend "
            "goes under symmetry.along.",
        )  # fmt: skip
