"""Stage `scp`: the scenario program of each dimension of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simgap.errors import UserError
from simgap.gap.fitting.dimension_fit import DimensionFit, fit_dimension
from simgap.gap.memory.hidden_state import HullFit, fit_hull
from simgap.gap.sampling.borders import MAKE_BORDERS, NO_BORDERS, directed_samples
from simgap.gap.sampling.points import AFTER_PREVIOUS, SEQUENCE, Columns, Points, remembers
from simgap.gap.sampling.samples import check_histories, dimension_samples, motion_of, previous_classes, steps_of
from simgap.gap.sampling.values import Room, in_memory
from simgap.io.arrays_on_disk import room_in
from simgap.plants.context import Context, pose_axes
from simgap.stages import Borders, CasePath, Grid, Out, Shards
from simgap.stages.gap_inputs import read_samples, write_dimensions


def run(case_path: CasePath, grid: Grid, shards: Shards, out: Out, borders: Borders = None) -> None:
    """Fit the bound of each state from the roll-outs of a grid, and those on borders and beside switching surfaces.

    Raises:
        UserError: damaged shards, settings that do not fit.
    """
    context = Context.load(case_path)
    with context.blame():
        beside = read_samples(context, borders, "borders") if borders is not None else None
        room = room_in(out.parent)
        write_dimensions(
            context, "scp", grid, shards, out, lambda p, rolled, i: scp(context, p, rolled, i, beside, room)
        )


def scp(
    context: Context, points: Points, shards: Sequence[Columns], i: int, borders: Columns | None = None,
    room: Room = in_memory,
) -> DimensionFit | HullFit:  # fmt: skip
    """Fit dimension i to the roll-outs, and to those on borders and beside switching surfaces; `room` is for samples.

    Raises:
        UserError: settings that do not fit the samples, shards of another grid, or a symmetry that the model lacks.
    """
    if remembers(context.case):
        check_histories(context, points, shards)
        grid, sequences = steps_of(context, shards, AFTER_PREVIOUS), steps_of(context, shards, SEQUENCE)
        return fit_hull(i, motion_of(context), grid, sequences, pose_axes(context), previous_classes(context))
    section = context.need(context.case.gap, "gap")
    if borders is None:
        raise UserError(NO_BORDERS, remedy=MAKE_BORDERS)
    samples = dimension_samples(context, points, shards, i, room)
    beside = directed_samples(context, points.name, borders, i)
    return fit_dimension(replace(samples, directed=beside), section)
