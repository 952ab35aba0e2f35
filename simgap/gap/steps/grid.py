"""Step `grid`: the states that cover X, or the earlier inputs that stand for a hidden state, and the inputs."""

from __future__ import annotations

from simgap.config.context import Context
from simgap.errors import UserError
from simgap.gap.hidden_state import previous_inputs
from simgap.gap.points import EVERY_HISTORY, HISTORIES, Points, covering_grid, remembers


def grid(context: Context, name: str) -> Points:
    """The samples of a point.

    Raises:
        UserError: a point that the case does not have, or counts that do not fit U.
    """
    if not remembers(context.case):
        return Points(name, covering_grid(context.case, context.box, name).centres(), context.input_set)
    hidden = context.need(context.case.hidden_state, "hidden_state")
    if name not in (HISTORIES, EVERY_HISTORY):
        raise UserError(
            f"'{name[:40]}' is no point of a case with a hidden state", remedy=f"Use {HISTORIES} or {EVERY_HISTORY}."
        )
    values = [context.domain.U[n].list() for n in context.inputs]
    asked = [hidden.previous[n] for n in context.inputs]
    counts = [len(own) for own in values] if name == EVERY_HISTORY else asked
    parts = [hidden.classes.get(n, 1) for n in context.inputs]
    return Points(name, previous_inputs(values, counts, parts), context.input_set)
