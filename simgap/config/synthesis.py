"""The sections `synthesis` and `sensing`: what the controller is asked for, its cells, what it knows of the state."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simgap.config.base import NotNegative, Section
from simgap.config.plugged import Plugged


class SynthesisSection(Section):
    """Cells of the abstraction and the specification."""

    OPTIONAL = ("record",)

    cells: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        min_length=1, max_length=4, description="Cells per state, in order, over the safe set or the arena."
    )
    specification: Annotated[Section, Plugged("specifications", "kind")] = Field(
        description="What the closed loop must do."
    )
    nominal_between_samples: bool = Field(
        False,
        description="Whether the nominal-only controller also checks what its model does between samples; by "
        "default, as in the paper, it considers the sampling instants only.",
    )
    record: Literal["all", "one"] = Field(
        "all",
        description="Whether the controller keeps all admissible inputs of a cell, a bit for each input, or the one "
        "that `least_effort` picks, two bytes: for very many cells and inputs, where something is to be reached. What "
        "it applies is the same; the audit, the margins and a certificate are then about that one input.",
    )
    rule: Literal["least_effort", "middle"] = Field(
        "least_effort", description="Which of the admissible inputs the controller applies."
    )


class SensingSection(Section):
    """A bounded measurement error and a latency in whole samples."""

    error: dict[str, NotNegative] = Field(
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
