"""A bound held against samples on borders and beside switching surfaces that no fit has seen, for step `gap`."""

from __future__ import annotations

from simgap.gap.fresh_check import BorderCheck, check_fresh
from simgap.gap.function import GapFunction
from simgap.gap.points import Columns
from simgap.gap.steps.borders import CHECK, border_gaps, border_states
from simgap.gap.switching import switching_surfaces
from simgap.plants.context import Context


def border_check(context: Context, name: str, rolled: Columns, function: GapFunction) -> BorderCheck:
    """The bound held against the samples of the check, which no fit has seen.

    Raises:
        UserError: a table of another case, or of another grid.
    """
    x, u, lower, upper = border_gaps(context, rolled, CHECK, border_states(context, name, CHECK))
    found = check_fresh(function, x, u, lower, d_upper=upper)
    return BorderCheck(len(x), found.violations, len(switching_surfaces(context)), found.worst, found.outside)
