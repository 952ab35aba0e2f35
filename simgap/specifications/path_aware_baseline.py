"""The case as the fair baseline has it: the nominal model alone, minding its path between samples."""

from __future__ import annotations

from dataclasses import replace

from simgap.errors import UserError
from simgap.plants.context import Context
from simgap.specifications.base import specification_of


def path_aware_baseline(context: Context) -> Context:
    """The case with the fair baseline: a nominal-only controller that checks its model between samples.

    Raises:
        UserError: a specification of the samples alone.
    """
    if not specification_of(context.case).between_samples:
        raise UserError(
            "needs a specification between samples; this one is about sampling instants alone",
            file=context.path, key="validation.fair_baseline", remedy="Take the key out.",
        )  # fmt: skip
    section = context.need(context.case.synthesis, "synthesis")
    asked = section.model_copy(update={"nominal_between_samples": True})
    return replace(context, case=context.case.model_copy(update={"synthesis": asked}))
