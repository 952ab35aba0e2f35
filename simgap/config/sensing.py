"""The `sensing` section: what the controller knows of the state."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from simgap.config.base import Section


class SensingSection(Section):
    """A bounded measurement error and a latency in whole samples."""

    error: dict[str, float] = Field(
        default_factory=dict, description="For a state, the largest |measured - true|, in its unit; 0 if not given."
    )
    latency: int = Field(0, ge=0, le=1, description="Samples between a measurement and the input that uses it.")
    latency_of: Literal["measurement", "input_delay"] = Field(
        "measurement",
        description="measurement: the latency comes on top of the delays that effects declare. input_delay: it is the "
        "first sample of these delays, so that the controller knows which input is pending; a command that would act "
        "earlier is held back until then.",
    )
    first_input: dict[str, float] = Field(
        default_factory=dict,
        description="With a latency, the input that acts in the first sample, before any measurement has arrived: one "
        "of domain.U. If not given, the one of least effort in U, rest where U holds it.",
    )

    @property
    def known_delay(self) -> int:
        """Samples of the inputs' delay that the controller knows of as its latency."""
        return self.latency if self.latency_of == "input_delay" else 0

    @field_validator("error")
    @classmethod
    def _not_negative(cls, value: dict[str, float]) -> dict[str, float]:
        bad = [name for name, e in value.items() if e < 0]
        if bad:
            raise ValueError(f"the error of {bad} is negative")
        return value
