"""The sections `validation` and `audit`: random and adversarial runs of a controller, and how many there are."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from simgap.config.base import Section


class Trials(StrEnum):
    """Numbers of random and adversarial trials: of a plain run, of `snakemake full`, of `snakemake audit_deep`."""

    PLAIN = "plain"
    FULL = "full"
    DEEP = "deep"


BUDGET = {Trials.PLAIN: (200_000, 20_000), Trials.FULL: (1_000_000, 100_000), Trials.DEEP: (10_000_000, 1_000_000)}
"""Evaluations and steps."""
BUDGET_OF_HISTORIES = {Trials.PLAIN: (6_000, 2_000), Trials.FULL: (30_000, 10_000), Trials.DEEP: (300_000, 100_000)}
"""Where the simulator remembers earlier inputs: one of its steps costs some hundred times as much."""


def _unless_given(index: int) -> str:
    """Words about the number that stands in for one that a case does not give."""
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
    seed: int = Field(21, ge=0, description="Seed of everything random in the audit.")

    def budget(self, histories: bool, trials: Trials = Trials.PLAIN) -> tuple[int, int]:
        """Evaluations and steps, `histories` where the simulator remembers inputs; a deep audit takes no less."""
        evaluations, steps = (BUDGET_OF_HISTORIES if histories else BUDGET)[trials]
        if trials == Trials.DEEP:
            return max(evaluations, self.evaluations or 0), max(steps, self.steps or 0)
        return self.evaluations or evaluations, self.steps or steps


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
        description="Whether a third controller runs from the same starts: made for the nominal model alone, like the "
        "nominal-only one, but checking what that model does between samples. For specifications of the whole "
        "path.",
    )

    def count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts of the gap-aware controller."""
        return self.starts or (STARTS if trials == Trials.PLAIN else FULL_STARTS)

    def baseline_count(self, trials: Trials = Trials.PLAIN) -> int:
        """Starts, of these, of each controller that it is compared with."""
        return min(self.count(trials), BASELINE_STARTS) if trials == Trials.PLAIN else self.count(trials)
