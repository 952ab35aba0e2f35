"""What a case asks of its controller, refused here where synthesis would refuse it after the roll-outs."""

from __future__ import annotations

from simgap.errors import UserError
from simgap.plants.context import Context
from simgap.specifications.base import path_aware_baseline, specification_of
from simgap.specifications.space import Space
from simgap.synthesis.games.game import one_input_only
from simgap.synthesis.games.layered import no_layers


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
        raise UserError(
            f"{len(section.cells)} cell counts for {region.size} states", key="synthesis.cells",
            remedy="Give one for each state, in order.",
        )  # fmt: skip
    if case.validation is not None and case.validation.fair_baseline:
        path_aware_baseline(context)
    late = case.sensing is not None and case.sensing.latency > 0
    blurred = late or (case.sensing is not None and any(case.sensing.error.values()))
    remembered = bool(case.hidden_state is not None and case.hidden_state.classes)
    before = (remembered, "a controller that remembers the input before")
    if section.record == "one":
        for stands, what in (
            (specification.holds, "a set that is to be held"),
            (section.rule != "least_effort", f"the rule `{section.rule}`"),
            (late, "a controller that remembers the input under way"),
            (blurred and specification.on_true_cells, "cells of the true state"),
            before,
        ):
            if stands:
                raise one_input_only(what)
    if section.layers > 1:
        for stands, what in (
            (not specification.holds, "what is to be reached"),
            (blurred, "a late measurement, or one with an error"),
            before,
            (bool(context.periodic), "states that wrap"),
        ):
            if stands:
                raise no_layers(what)
