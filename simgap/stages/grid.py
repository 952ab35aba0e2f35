"""Stage `grid`: the samples at which simulator and nominal model are compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from simgap.errors import UserError
from simgap.gap.memory.hidden_state import previous_inputs
from simgap.gap.sampling.points import (
    EVERY_HISTORY,
    HISTORIES,
    Points,
    covering_grid,
    known_radius,
    own_point,
    remembers,
    state_names,
)
from simgap.lint.costs import affordable, costs
from simgap.plants.context import Context
from simgap.stages import CasePath, Option, log
from simgap.stages.gap_inputs import write_points


def run(
    case_path: CasePath,
    point: Annotated[
        str | None, Option("eps~ and the radius of the balls that cover X; hidden-state or full-table for a robot.")
    ],
    out: Annotated[Path, Option("Folder to write states and inputs to (Parquet).", writes="folder")],
) -> None:
    """Write states (or earlier inputs) and inputs of a point, the case's own if none is named, to the folder `out`.

    Raises:
        UserError: a point that the case does not have.
    """
    context = Context.load(case_path)
    with context.blame():
        name = point or own_point(context.case)
        eps = known_radius(name) if not remembers(context.case) else None
        affordable(context, [cost for cost in costs(context, eps=eps) if cost.key.startswith(("grid", "hidden_state"))])
        points = grid(context, name)
    states = state_names(context.case)
    units = context.units | {n: context.units[n.removeprefix("previous_")] for n in states}
    record = context.record("grid", point=points.name)
    write_points(out, points, (states, context.inputs), units, record)
    log.info("%s: %d x %d samples", points.name, len(points.states), len(points.inputs))


def grid(context: Context, name: str) -> Points:
    """The samples of a point.

    Raises:
        UserError: a point that the case does not have, or counts that do not fit U.
    """
    if not remembers(context.case):
        return Points(name, covering_grid(context.case, context.box, name).centres(), context.input_set)
    hidden = context.need(context.case.hidden_state, "hidden_state")
    if name not in (HISTORIES, EVERY_HISTORY):
        remedy = f"Use {HISTORIES} or {EVERY_HISTORY}."
        raise UserError(f"'{name[:40]}' is not a point of a case with a hidden state", remedy=remedy)
    values = [context.domain.U[n].list() for n in context.inputs]
    declared = [hidden.previous[n] for n in context.inputs]
    counts = [len(own) for own in values] if name == EVERY_HISTORY else declared
    parts = [hidden.classes.get(n, 1) for n in context.inputs]
    return Points(name, previous_inputs(values, counts, parts), context.input_set)
