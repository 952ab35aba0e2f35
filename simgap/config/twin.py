"""The `twin` section: another engine that the case's simulator stands for, and how close it must be."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from simgap.config.base import Section
from simgap.config.plugged import Plugged
from simgap.config.simulator import EngineSection


class TwinSection(Section):
    """What a simulator in closed form stands for: both take every step of the run, the differences are printed."""

    of: Annotated[EngineSection, Plugged("engines", "engine")] = Field(
        description="The engine it stands for, with its keys, as in `simulator`."
    )
    tolerance: dict[str, float] = Field(
        default_factory=dict,
        description="For a state, the largest difference after one step that is taken, in its unit; more fails the "
        "run. States that are not named are measured and not judged.",
    )

    @field_validator("tolerance")
    @classmethod
    def _not_negative(cls, value: dict[str, float]) -> dict[str, float]:
        bad = [name for name, limit in value.items() if limit < 0]
        if bad:
            raise ValueError(f"the tolerance of {bad} is negative")
        return value
