"""A path between samples that has no bound, found in `check` and not after the roll-outs."""

from __future__ import annotations

import numpy as np

from simgap.errors import BrokenPromise
from simgap.geometry import Floats
from simgap.notation import pretty_unit
from simgap.simulators.behind_commands import acts_at_once
from simgap.simulators.surprises import Finding
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages.context import Context
from simgap.synthesis.intersample import Flow, enough, excursion, flow_of


def between_samples(context: Context) -> list[Finding]:
    """A finding for each state along which the nominal path alone may stray by half of X or more between samples.

    The gap makes it no less, so that what is refused here is refused by synthesis.

    Raises:
        BrokenPromise: no bound at all, where the specification promises something between samples.
    """
    case = context.case
    if case.synthesis is None or not context.plant.carried.derived:
        return []
    symbolic, specification, space = case.plant.symbolic, specification_of(case), Space.of(case)
    asked = case.gap is not None or case.synthesis.nominal_between_samples
    if not (specification.between_samples and asked) or (symbolic is not None and symbolic.wheels is not None):
        return []
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
    if full:  # its slopes take seconds to compile, and are not asked where the rates say enough
        flow = flow_of(context.plant.carried, smooth=acts_at_once(case))
        reach, full = taken(flow)
    found = []
    for j in full:
        unit = pretty_unit(context.units[context.states[j]])
        shorter = enough(flow, region, context.input_set, tau, none)
        found.append(
            Finding(
                "domain.tau",
                f"between samples {context.states[j]} may stray by {reach[j]:.3g} {unit}, by the nominal model's rates "
                "over X and U, and that is left free on each side: nothing of X stays",
                f"Shorten tau{f' to about {shorter:g} s' if shorter else ''}, or shrink X",
            )
        )
    return found
