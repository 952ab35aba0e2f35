"""The `validation` section: the closed loop in the simulator."""

from __future__ import annotations

from pydantic import Field

from simgap.config.base import Section
from simgap.config.trials import Trials

STARTS, FULL_STARTS = 300, 1000
"""Of a plain run and of a full one: if none of them fails, at most 1 % and 0.3 % do, with 95 % confidence."""
BASELINE_STARTS = 200
"""Of each controller that a plain run only compares with; nothing is promised of them."""


class ValidationSection(Section):
    """How many runs, how long, and which of them are kept in full."""

    starts: int | None = Field(
        None,
        ge=1,
        description="Starts, drawn from the winning domain of the gap-aware controller; if not given "
        f"{STARTS:,}, {FULL_STARTS:,} in a full run. In a plain run the controllers to compare with take "
        f"{BASELINE_STARTS:,} of them.",
    )
    first: tuple[dict[str, float], ...] = Field(
        (), description="States to start from before the drawn ones; each must be in both winning domains."
    )
    steps: int = Field(2000, ge=1, description="Samples a run.")
    seed: int = Field(0, ge=0, description="Seed of the starts.")
    kept: int = Field(4, ge=1, description="Runs of each controller whose traces are written.")
    fair_baseline: bool = Field(
        False,
        description="Whether a third controller runs from the same starts: made for the nominal model alone, as the "
        "nominal-only one, but minding what that model does between samples. For specifications of the whole path.",
    )

    def count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts of the gap-aware controller."""
        return self.starts or (STARTS if trials == Trials.PLAIN else FULL_STARTS)

    def baseline_count(self, trials: Trials = Trials.PLAIN) -> int:
        """Of these, as many as the controllers that it is compared with take."""
        return min(self.count(trials), BASELINE_STARTS) if trials == Trials.PLAIN else self.count(trials)
