"""Sections of a case with a wheeled robot: its hidden state, its symmetry."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from simgap.config.base import Section


class SymmetrySection(Section):
    """What the gap does not depend on: position and heading (SE(2)), or some states; measured, not believed."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("along",)

    group: Literal["planar", "translation"] = Field(
        "planar",
        description="planar: position and heading of `plant.symbolic.wheels`. translation: the gap does not depend on "
        "the states `along`, such as where a cart stands.",
    )
    along: tuple[str, ...] = Field((), description="translation: the states on which the gap does not depend.")
    headings: int = Field(8, ge=1, description="Random headings (or shifts) at which each checked history is repeated.")
    histories: int = Field(100, ge=1, description="Random histories (or states) that are repeated at them.")
    tolerance: dict[str, float] = Field(
        description="For each state the largest deviation between headings (or shifts); above it the stage fails."
    )
    seed: int = Field(3, ge=0, description="Of histories and headings.")

    @model_validator(mode="after")
    def _along_what(self) -> SymmetrySection:
        if (self.group == "translation") != bool(self.along):
            raise ValueError("a translation, and nothing else, is `along` states: name them there")
        if self.along and self.headings < 3:
            raise ValueError("a translation is measured at both ends of X and between: headings is at least 3")
        return self


class HiddenStateSection(Section):
    """What earlier inputs leave behind in the simulator, and how it is covered."""

    previous: dict[str, int] = Field(
        description="For each input how many of its values stand for the previous input: the extremes and between."
    )
    classes: dict[str, int] = Field(
        default_factory=dict,
        description="For each input, the number of intervals that divide the previous input into classes: the bound is "
        "taken for each class, and the controller remembers the class. None: one class, no memory.",
    )
    length: int = Field(
        4, ge=1, description="Longest histories tried; the bound must stop growing by then (inputs before the present)."
    )
    chains: int = Field(40, ge=2, description="Random input sequences that look for what the previous inputs missed.")
    chain_length: int = Field(500, ge=10, description="Samples in each of them.")
    growth: float = Field(
        0.1, gt=0, description="Largest growth with longer histories, relative to the bound's sup, that counts as none."
    )
    seed: int = Field(2, ge=0, description="Of the random sequences.")
    fresh_samples: int = Field(
        20_000, ge=1, description="Steps of other random sequences on which the bound is checked; no bound sees them."
    )
    fresh_length: int = Field(
        5, ge=2, description="Samples in each fresh sequence: sequences are independent, steps of one are not."
    )
    fresh_seed: int = Field(11, ge=0, description="Of those.")
    search: int = Field(
        2000, ge=0, description="Steps of a directed search over histories and headings that widens the bound, and as "
        "many of a second one that must not break it; 0: neither."
    )  # fmt: skip
    search_length: int = Field(2, ge=1, description="Inputs before the present one in these searches.")
    search_seed: int = Field(21, ge=0, description="Of the first of them; the second takes the next.")
    tolerated_probability: float = Field(
        0.0, ge=0.0, lt=1.0, description="Largest bound of the violation probability; 0: one violation fails the stage."
    )

    @model_validator(mode="after")
    def _fresh_is_fresh(self) -> HiddenStateSection:
        if self.fresh_seed == self.seed:
            raise ValueError(f"fresh_seed and seed are both {self.seed}: the check would see what made the bound")
        return self
