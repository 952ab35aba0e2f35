"""Step `scp`: the scenario program of one dimension, or what stands in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simgap.config.pose import pose_axes
from simgap.errors import UserError
from simgap.gap.dimension_fit import DimensionFit, fit_dimension
from simgap.gap.hidden_fit import HullFit, fit_hull
from simgap.gap.points import Columns, Points, remembers
from simgap.gap.settings import GapSettings
from simgap.gap.steps.borders import MAKE_BORDERS, NO_BORDERS, directed_samples
from simgap.gap.steps.samples import check_histories, dimension_samples, motion_of, previous_classes, steps_of
from simgap.gap.steps.tables import AFTER_PREVIOUS, SEQUENCE
from simgap.gap.values import Held, Room
from simgap.plants.context import Context


def scp(
    context: Context, points: Points, shards: Sequence[Columns], i: int, borders: Columns | None = None,
    room: Room = Held.room,
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
    return fit_dimension(replace(samples, directed=beside), GapSettings.of(section))
