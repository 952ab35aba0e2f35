"""The `audit` section: the budget of the adversary that searches for what random samples do not meet."""

from __future__ import annotations

from pydantic import Field

from simgap.config.base import Section
from simgap.config.trials import Trials

BUDGET = {Trials.PLAIN: (200_000, 20_000), Trials.FULL: (1_000_000, 100_000), Trials.DEEP: (10_000_000, 1_000_000)}
"""Evaluations and steps."""
BUDGET_OF_HISTORIES = {Trials.PLAIN: (6_000, 2_000), Trials.FULL: (30_000, 10_000), Trials.DEEP: (300_000, 100_000)}
"""Where the simulator remembers earlier inputs: one of its steps costs some hundred times as much."""


def _unless_given(index: int) -> str:
    """What stands in for a number that a case does not give."""
    plain, full = ((BUDGET[t][index], BUDGET_OF_HISTORIES[t][index]) for t in (Trials.PLAIN, Trials.FULL))
    return f"if not given {plain[0]:,}, {full[0]:,} in a full run; {plain[1]:,} and {full[1]:,} with a hidden_state."


class AuditSection(Section):
    """How hard the adversary tries."""

    evaluations: int | None = Field(
        None,
        ge=1,
        description=f"Steps of the simulator on which the gap's bound is attacked; {_unless_given(0)}",
    )
    steps: int | None = Field(
        None,
        ge=1,
        description="Closed-loop steps under the worst admissible inputs, in the simulator and as many against "
        f"the worst disturbance; {_unless_given(1)}",
    )
    seed: int = Field(21, ge=0, description="Of everything random in it.")

    def budget(self, histories: bool, trials: Trials = Trials.PLAIN) -> tuple[int, int]:
        """Evaluations and steps, `histories` where the simulator remembers inputs; a deep audit takes no less."""
        evaluations, steps = (BUDGET_OF_HISTORIES if histories else BUDGET)[trials]
        if trials == Trials.DEEP:
            return max(evaluations, self.evaluations or 0), max(steps, self.steps or 0)
        return self.evaluations or evaluations, self.steps or steps
