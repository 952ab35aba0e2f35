"""Stage `scp`: the scenario program of one dimension of the gap."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from simgap.gap.steps.scp import scp
from simgap.io.documents import write_json
from simgap.io.stored import room_in
from simgap.provenance import provenance
from simgap.stages.context import Context, log
from simgap.stages.made import Shards, blame_shards, dimension, points_of_case, samples_of


def run(
    case_path: Path, state: str, grid: Path, shards: Sequence[Path], out: Path, borders: Path | None = None
) -> None:
    """Fit the bound of one state from the roll-outs of a grid, and those on borders and beside switching surfaces.

    Raises:
        UserError: a state that the case does not have, damaged shards, settings that do not fit.
    """
    context = Context.load(case_path)
    i = dimension(context, state)
    with context.blame(), blame_shards(shards):
        points = points_of_case(context, grid)
        log.info("%s of %d samples x %d inputs", state, len(points.states), len(points.inputs))
        began = time.perf_counter()
        beside = samples_of(context, borders, "borders") if borders is not None else None
        found = scp(context, points, Shards(context, shards), i, beside, room_in(out.parent))
    log.info("fitted in %.2f s, roll-outs read and compared with the nominal model", time.perf_counter() - began)
    record = provenance("scp", context.case, context.folder, point=points.name)
    write_json(out, {"state": state, **found.to_json(), "provenance": record})
