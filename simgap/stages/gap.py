"""Stage `gap`: the dimensions put together to a bound on all of X x U, checked on fresh samples."""

from __future__ import annotations

import resource
from pathlib import Path
from typing import Annotated

from simgap.gap.checked_bound import Made, gap, seeds
from simgap.io.results import table, write_json, write_parquet
from simgap.plants.context import Context
from simgap.stages import Borders, CasePath, Grid, Option, Out, Shards, log
from simgap.stages.gap_inputs import Rolled, blame_shards, points_of_case, read_dimensions, read_samples


def run(
    case_path: CasePath,
    grid: Grid,
    rollouts: Shards,
    scp: Annotated[Path, Option("Scenario programs.")],
    lipschitz: Annotated[Path, Option("Lipschitz estimates.")],
    fresh: Annotated[Path, Option("Fresh samples to check the bound on.")],
    out: Out,
    thinned: Annotated[Path, Option("File for thinned samples, for pictures (Parquet).", "--samples")],
    borders: Borders = None,
) -> None:
    """Put the dimensions together, check the bound on the fresh samples, write it and a few samples for pictures.

    Raises:
        UserError: damaged files, or files of another case.
        BrokenPromise: a compiled model that differs from Drake's, a Lipschitz constant that cannot be trusted, or more
            violations than the case tolerates.
    """
    context = Context.load(case_path)
    with context.blame(), blame_shards(rollouts):
        context.plant.check_with_drake(context.box, context.input_set)
        points = points_of_case(context, grid)
        content = Made(
            points,
            read_dimensions(context, "scp", points.name, scp),
            read_dimensions(context, "lipschitz", points.name, lipschitz),
            Rolled(context, rollouts),
            read_samples(context, fresh, "fresh"),
            read_samples(context, borders, "borders") if borders else None,
        )
        bound = gap(context, content)
    log.info("%s", bound.check.tier.text)
    units = context.units | {f"gap_{n}": context.units[n] for n in context.states}
    write_parquet(thinned, table(bound.thinned, units, {"case": context.case.name}, context.record("gap")))
    record = context.record("gap", seeds(context), point=content.points.name)
    write_json(out, bound.content | {"provenance": record})
    log.info("peak memory %d MiB", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
