"""Stage `grid`: the samples at which simulator and nominal model are compared."""

from __future__ import annotations

from pathlib import Path

from simgap.gap.points import known_radius, own_point, remembers, state_names
from simgap.gap.steps.grid import grid
from simgap.io.samples import write_points
from simgap.provenance import provenance
from simgap.stages.context import Context, log
from simgap.stages.costs import affordable, costs


def run(case_path: Path, point: str | None, out: Path) -> None:
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
    record = provenance("grid", context.case, context.folder, point=points.name)
    write_points(out, points, (states, context.inputs), units, record)
    log.info("%s: %d x %d samples", points.name, len(points.states), len(points.inputs))
