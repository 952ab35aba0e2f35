"""Checks of the controller that a case wants, refused here where synthesis would refuse it after the roll-outs."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, Finding, UserError
from simgap.notation import pretty_unit
from simgap.plants.context import Context
from simgap.simulators.commands import acts_at_once
from simgap.specifications.base import path_aware_baseline, specification_of
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.intersample import Flow, enough, excursion, flow_of
from simgap.synthesis.games.game import one_input_only


def find_no_controller(context: Context) -> list[Finding]:
    """A finding where the case says why it asks for no controller, as a new one does for which none was found."""
    why, _, remedy = context.case.no_controller.partition(". ")
    if context.case.synthesis is not None or not why:
        return []
    return [Finding("no_controller", f"a run ends with the bound: {why}", remedy)]


def refuse_specification(context: Context) -> None:
    """Refuse a specification that does not fit X, and what a controller cannot be recorded or solved with.

    Raises:
        UserError: with the key.
    """
    case, section = context.case, context.case.synthesis
    if section is None:
        return
    specification = specification_of(case)
    region = specification.region(Space.of(case))
    if len(section.cells) != region.size:
        problem = f"{len(section.cells)} cell counts for {region.size} states"
        raise UserError(problem, key="synthesis.cells", remedy="Give one for each state, in order.")
    space = Space.of(case)
    error = space.vector(case.sensing.error if case.sensing is not None else {})
    specification.fit(space, space.grid(region, section.cells), error)
    if case.validation is not None and case.validation.fair_baseline:
        path_aware_baseline(context)
    late = case.sensing is not None and case.sensing.latency > 0
    blurred = late or (case.sensing is not None and any(case.sensing.error.values()))
    remembered = bool(case.hidden_state is not None and case.hidden_state.classes)
    if section.record == "one":
        for stands, what in (
            (specification.holds, "a set that is to be held"),
            (section.rule != "least_effort", f"the rule `{section.rule}`"),
            (late, "a controller that remembers the input under way"),
            (blurred and specification.on_true_cells, "cells of the true state"),
            (remembered, "a controller that remembers the input before"),
        ):
            if stands:
                raise one_input_only(what)


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
    between = case.gap is not None or case.synthesis.nominal_between_samples
    if not (specification.between_samples and between) or (symbolic is not None and symbolic.wheels is not None):
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
            "the nominal model's rates over X and U, and that margin on each side leaves nothing of X",
            key="domain.tau", remedy=f"Shorten tau{f' to about {shorter:g} s' if shorter else ''}, or shrink X.",
        )  # fmt: skip
