"""Stage `lipschitz`: how fast each dimension of the gap changes between samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.gap.lipschitz.grid import DimensionLipschitz
from simgap.gap.memory.hidden_state import HistoryInfluence, fading
from simgap.gap.sampling.points import HISTORY, Columns, Points, remembers
from simgap.gap.sampling.samples import check_histories, dimension_samples
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.gap.sampling.values import Room, in_memory
from simgap.io.arrays_on_disk import room_in
from simgap.plants.context import Context
from simgap.stages import CasePath, Grid, Out, Shards
from simgap.stages.gap_inputs import write_dimensions


def run(case_path: CasePath, grid: Grid, shards: Shards, out: Out) -> None:
    """Estimate the Lipschitz constant of each state from the roll-outs of a grid.

    Raises:
        UserError: damaged shards, settings that do not fit.
    """
    context = Context.load(case_path)
    with context.blame():
        room = room_in(out.parent)
        write_dimensions(
            context, "lipschitz", grid, shards, out, lambda p, rolled, i: lipschitz(context, p, rolled, i, room)
        )


def lipschitz(
    context: Context, points: Points, shards: Sequence[Columns], i: int, room: Room = in_memory
) -> DimensionLipschitz | HistoryInfluence:
    """Slopes of dimension i on the grid with extreme-value estimates beside them; no basis and no padding enters.

    For a simulator that remembers earlier inputs: how their influence fades, and the deviation between headings.

    Raises:
        UserError: shards of another grid, or one that is too coarse for a slope.
    """
    if remembers(context.case):
        check_histories(context, points, shards)
        return _influence(context, shards, i)
    from simgap.gap.lipschitz.estimates import dimension_lipschitz

    section = context.need(context.case.gap, "gap")
    return dimension_lipschitz(dimension_samples(context, points, shards, i, room), section)


def _influence(context: Context, shards: Sequence[Columns], i: int) -> HistoryInfluence:
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    kept = [rolled["part"] == HISTORY for rolled in shards]
    moved = np.concatenate([s[f"moved_{context.states[i]}"][rows] for s, rows in zip(shards, kept, strict=True)])
    responses = moved.reshape(-1, hidden.length + symmetry.headings).T[..., None]  # (L + H, n, 1)
    straight, turned = responses[: hidden.length], responses[hidden.length :]
    deviation = SymmetryDeviation.of_headings(straight[-1], turned)
    return HistoryInfluence(fading(straight)[:, 0], float(deviation.largest[0]), deviation.samples)
