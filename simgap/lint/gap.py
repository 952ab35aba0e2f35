"""A `gap` section that would be refused after the roll-outs: too few cells along a state, symbols that do not exist."""

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


def refuse_basis(context: Context) -> None:
    """Refuse a basis with symbols that do not exist, or without a range over X and U.

    Raises:
        UserError: with the key.
    """
    section = context.case.gap
    if section is None or section.bound not in ("scenario", "conformal") or context.case.domain is None:
        return
    from simgap.gap.bounds.basis import widened
    from simgap.gap.fitting.linear_fit import listed_basis  # takes a second: only paid by cases that get this far

    try:
        free = free_axes(context.case)
        basis = listed_basis(section.basis, context.states, context.inputs, context.box, free)
        _ = basis.ranges(widened(context.box), context.input_set)
    except UserError as error:
        raise UserError(error.problem, key=error.key or "gap.basis", remedy=error.remedy) from None
