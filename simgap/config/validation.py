"""The `validation` section: the closed loop in the simulator."""

from __future__ import annotations

from pydantic import Field

from simgap.config.base import Section


class ValidationSection(Section):
    """How many runs, how long, and which of them are kept in full."""

    starts: int = Field(1000, ge=1, description="Starts, drawn from the winning domain of the gap-aware controller.")
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
