"""The `budget` section: what a run may cost before `simgap check` refuses it."""

from __future__ import annotations

import os

from pydantic import Field

from simgap.config.base import Section
from simgap.config.quantity import Gibibytes, Hours


class BudgetSection(Section):
    """Limits that a case is held against before anything runs."""

    memory: Gibibytes | None = Field(
        None, gt=0, description="Most memory of one stage, in GiB or with a unit; half of the machine's if not given."
    )
    time: Hours = Field(1.0, gt=0, description="Most time of one stage on one core, in hours or with a unit.")

    @property
    def bytes(self) -> float:
        """`memory` in bytes."""
        if self.memory is not None:
            return self.memory * 2.0**30
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
