"""Stage `grid`: the samples at which simulator and nominal model are compared."""

from __future__ import annotations

from pathlib import Path

from simgap.gap.points import own_point, state_names
from simgap.gap.steps.grid import grid
from simgap.io.samples import write_points
from simgap.provenance import provenance
from simgap.stages.context import Context, log


def run(case_path: Path, point: str | None, out: Path) -> None:
    """Write states (or earlier inputs) and inputs of a point, the case's own if none is named, to the folder `out`.

    Raises:
        UserError: a point that the case does not have.
    """
    context = Context.load(case_path)
    with context.blame():
        points = grid(context, point or own_point(context.case))
    states = state_names(context.case)
    units = context.units | {n: context.units[n.removeprefix("previous_")] for n in states}
    record = provenance("grid", context.case, context.folder, point=points.name)
    write_points(out, points, (states, context.inputs), units, record)
    log.info("%s: %d x %d samples", points.name, len(points.states), len(points.inputs))
