"""The `audit` section: the budget of the adversary that searches for what random samples do not meet."""

from __future__ import annotations

from pydantic import Field

from simgap.config.base import Section

DEFAULT_EVALUATIONS, DEFAULT_STEPS = 1_000_000, 100_000
DEFAULT_EVALUATIONS_OF_HISTORIES, DEFAULT_STEPS_OF_HISTORIES = 30_000, 10_000
"""Where the simulator remembers earlier inputs: one of its steps costs some hundred times as much."""


class AuditSection(Section):
    """How hard the adversary tries."""

    evaluations: int | None = Field(
        None,
        ge=1,
        description="Steps of the simulator on which the gap's bound is attacked; if not given "
        f"{DEFAULT_EVALUATIONS:,}, {DEFAULT_EVALUATIONS_OF_HISTORIES:,} with a hidden_state.",
    )
    steps: int | None = Field(
        None,
        ge=1,
        description="Closed-loop steps under the worst admissible inputs, in the simulator and as many against the "
        f"worst disturbance; if not given {DEFAULT_STEPS:,}, {DEFAULT_STEPS_OF_HISTORIES:,} with a hidden_state.",
    )
    seed: int = Field(21, ge=0, description="Of everything random in it.")

    def budget(self, histories: bool) -> tuple[int, int]:
        """Evaluations and steps, `histories` where the simulator remembers earlier inputs."""
        evaluations = DEFAULT_EVALUATIONS_OF_HISTORIES if histories else DEFAULT_EVALUATIONS
        steps = DEFAULT_STEPS_OF_HISTORIES if histories else DEFAULT_STEPS
        return self.evaluations or evaluations, self.steps or steps
