"""A path between samples that has no bound, found in `check` and not after the roll-outs."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.notation import pretty_unit
from simgap.plants.context import Context
from simgap.simulators.behind_commands import acts_at_once
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.intersample import Flow, enough, excursion, flow_of


def refuse_free_path(context: Context) -> None:
    """Refuse a case whose nominal path alone may stray by half of X or more between samples.

    The gap makes it no less, so that what is refused here would win nothing after the roll-outs.

    Raises:
        UserError: such a case, or one whose path has no bound at all, with a tau that would do.
    """
    case = context.case
    if case.synthesis is None or not context.plant.carried.derived:
        return
    symbolic, specification, space = case.plant.symbolic, specification_of(case), Space.of(case)
    asked = case.gap is not None or case.synthesis.nominal_between_samples
    if not (specification.between_samples and asked) or (symbolic is not None and symbolic.wheels is not None):
        return
    if specification.swept_boxes and specification.on_floor(space) and not specification.on_true_cells:
        return  # boxes of a path's whole way take the place of a distance
    region, none, tau = specification.region(space), np.zeros(len(context.states)), context.domain.tau
    ends = [j for j in range(region.size) if j not in context.periodic]

    def taken(flow: Flow) -> tuple[Floats, list[int]]:
        (_, walls), _ = excursion(flow, region, context.input_set, tau, none, context.states)
        return walls, [j for j in ends if 2.0 * walls[j] >= region.hi[j] - region.lo[j]]

    flow = flow_of(context.plant.carried, smooth=False)
    try:
        reach, full = taken(flow)
    except BrokenPromise:
        full = ends
    if not full:
        return
    flow = flow_of(context.plant.carried, smooth=acts_at_once(case))  # its slopes take seconds to compile
    try:
        reach, full = taken(flow)
    except BrokenPromise as error:
        raise UserError(str(error), key="domain.tau") from None
    if full:
        state, shorter = context.states[full[0]], enough(flow, region, context.input_set, tau, none)
        raise UserError(
            f"between samples {state} may stray by {reach[full[0]]:.3g} {pretty_unit(context.units[state])}, by "
            "the nominal model's rates over X and U, and that is left free on each side: nothing of X stays",
            key="domain.tau", remedy=f"Shorten tau{f' to about {shorter:g} s' if shorter else ''}, or shrink X.",
        )  # fmt: skip
