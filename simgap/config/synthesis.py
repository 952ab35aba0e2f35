"""The `synthesis` section: what the controller is asked for, and on which cells."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simgap.config.base import Section
from simgap.config.plugged import Plugged


class SynthesisSection(Section):
    """Cells of the abstraction and the specification."""

    cells: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        min_length=1, max_length=4, description="Cells per state, in order, over the safe set or the arena."
    )
    specification: Annotated[Section, Plugged("specifications", "kind")] = Field(
        description="What the closed loop must do."
    )
    nominal_between_samples: bool = Field(
        False,
        description="Whether the nominal-only controller also checks what its model does between samples; by "
        "default, as in the paper, it looks at the sampling instants only.",
    )
    record: Literal["all", "one"] = Field(
        "all",
        exclude_if=lambda value: value == "all",  # what a case reads that does not ask for it stays what it was
        description="Whether the controller keeps all admissible inputs of a cell, a bit for each input, or the one "
        "that `least_effort` picks, two bytes: for very many cells and inputs, where something is to be reached. What "
        "it applies is the same; the audit, the margins and a certificate are then about that one input.",
    )
    layers: int = Field(
        1, ge=1, le=8,
        exclude_if=lambda value: value == 1,
        description="Sizes of cells by which a set to be held is found, the largest of 2^(layers - 1) cells a side: "
        "large ones are split only where they do not decide. The result is that of one layer, bit for bit; from three "
        "states on 3 is several times faster. For perfect measurements, states that do not wrap, and a gap that "
        "depends on few states.",
    )  # fmt: skip
    rule: Literal["least_effort", "middle"] = Field(
        "least_effort", description="Which of the admissible inputs the controller applies."
    )
