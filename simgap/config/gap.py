"""The `gap` section: how the gap between simulator and nominal model is bounded."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator, model_validator

from simgap.config.base import Section


class BasisSection(Section):
    """A basis of the registry with its options."""

    kind: str = Field(description="monomials, trigonometric, blocks or expressions.")
    degree: int | None = Field(None, ge=0, description="monomials: largest total degree; inputs enter linearly.")
    harmonics: int | None = Field(None, ge=1, description="trigonometric: harmonics along each state axis.")
    terms: tuple[str, ...] | None = Field(None, description="expressions: the terms, over states and inputs.")
    blocks: tuple[int, ...] | None = Field(None, description="blocks: number of blocks along each state axis.")
    per_input: bool | None = Field(None, description="blocks: a value for each input (true) or one for all inputs.")

    @model_validator(mode="after")
    def _options_of_kind(self) -> BasisSection:
        known = {
            "monomials": {"degree"},
            "trigonometric": {"harmonics"},
            "expressions": {"terms"},
            "blocks": {"blocks", "per_input"},
        }
        if self.kind not in known:
            raise ValueError(f"there is no basis '{self.kind}'. Known bases: {', '.join(known)}.")
        given = set(self.options())
        if given - known[self.kind]:
            raise ValueError(f"the basis '{self.kind}' has no option {', '.join(sorted(given - known[self.kind]))}")
        return self

    def options(self) -> dict[str, object]:
        """The options that were given."""
        fields = ("degree", "harmonics", "terms", "blocks", "per_input")
        return {name: getattr(self, name) for name in fields if getattr(self, name) is not None}


class LipschitzSection(Section):
    """Lipschitz estimates."""

    rough_limit: float = Field(
        0.1, ge=0.0, le=1.0,
        description="Largest share of the cells in which the gap may jump (padding inflate covers them by the jump "
        "seen there); more is refused.",
    )  # fmt: skip
    extreme_value: bool = Field(True, description="Also compute the paper's extreme-value estimates, for comparison.")
    extreme_value_blocks: int = Field(100, ge=10, description="Blocks of random pairs, one maximum slope from each.")
    extreme_value_pairs: int = Field(100, ge=10, description="Random pairs in a block.")


class ConformalSection(Section):
    """Split conformal bound."""

    miscoverage: float = Field(
        0.01, gt=0.0, lt=1.0, description="Probability with which a random sample may lie outside."
    )
    calibration_samples: int = Field(
        20_000, ge=100, description="Random samples that set the width; neither the fit nor the check sees them."
    )
    seed: int = Field(3, ge=0, description="Of these samples; differs from `gap.seed`, which draws those of the check.")


class GapSection(Section):
    """How the gap d = simulator - nominal is bounded on all of X x U, and how the bound is checked."""

    basis: tuple[str | float, ...] | BasisSection = Field(
        description="Terms of the bound as expressions over states and inputs, such as [x1^2, x1*x2, u, 1]; or a kind "
        "with options, such as {kind: monomials, degree: 2}."
    )
    bound: Literal["scenario", "conformal", "envelope", "constant"] = Field(
        "scenario",
        description="scenario: linear in the basis, by the scenario program. constant: the same with the basis 1. "
        "envelope: Lipschitz envelope around the samples (set membership). conformal: covers a random sample with a "
        "stated probability, not every state.",
    )
    objective: Literal["lexicographic", "eta"] = Field(
        "lexicographic",
        description="eta: the smallest supremum (the paper). lexicographic: the smallest mean among bounds whose "
        "supremum is at most `slack` of the largest gap above the smallest one.",
    )
    slack: float = Field(0.01, ge=0.0, le=1.0, description="See objective; a share of the largest sampled gap.")
    sides: Literal["signed", "unsigned"] = Field(
        "signed", description="signed: lower and upper bound fitted separately. unsigned: |d| <= gamma (the paper)."
    )
    padding: Literal["inflate", "per_axis", "paper"] = Field(
        "inflate",
        description="How the bound is carried from samples to all states: inflate: local Lipschitz constants of the "
        "residual inside the program. per_axis: sum_j (L1_j + L2_j) h_j. paper: (L1 + L2) eps.",
    )
    tolerated_probability: float = Field(
        0.0, ge=0.0, lt=1.0,
        description="0: one violation among the fresh samples fails the stage. Otherwise the Clopper-Pearson bound of "
        "the violation probability may reach this value, and it is printed in the headline.",
    )  # fmt: skip
    fresh_samples: int = Field(
        300_000, ge=1, description="Random off-grid samples for the check, never used in the fit."
    )
    remainder: dict[str, float] = Field(
        default_factory=dict,
        description="For a state, what measured data leave unexplained in one step, in its unit; added on both sides "
        "of the bound so that it covers the hardware and not the simulator alone. `simgap diagnose` writes it.",
    )
    confidence: float = Field(0.95, gt=0.5, lt=1.0, description="Of the Clopper-Pearson bound.")
    envelope_nodes: int = Field(200_000, ge=16, description="envelope: most numbers in the table that is saved.")
    lipschitz: LipschitzSection = Field(LipschitzSection(), description="How Lipschitz constants are estimated.")
    conformal: ConformalSection = Field(ConformalSection(), description="Options of the conformal bound.")
    seed: int = Field(1, ge=0, description="Of the fresh samples and of everything random in the fit.")

    @field_validator("basis", mode="before")
    @classmethod
    def _numbers_are_terms(cls, value: object) -> object:
        """The constant term is written 1, which YAML reads as a number."""
        return [str(term) for term in value] if isinstance(value, list) else value

    @model_validator(mode="after")
    def _some_terms(self) -> GapSection:
        if isinstance(self.basis, tuple) and not self.basis:
            raise ValueError("the basis has no terms; list at least the constant 1")
        return self

    @model_validator(mode="after")
    def _conformal_is_tolerated(self) -> GapSection:
        missed, tolerated = self.conformal.miscoverage, self.tolerated_probability
        if self.bound == "conformal" and tolerated <= missed:
            raise ValueError(
                f"bound: conformal leaves out a random sample with probability up to {missed:g} "
                f"(conformal.miscoverage), so the check on fresh samples needs a tolerated_probability above that, "
                f"such as {1.2 * missed:.3g}; it is {tolerated:g}"
            )
        if self.bound == "conformal" and self.conformal.seed == self.seed:
            raise ValueError(f"conformal.seed and seed are both {self.seed}: the check would see what set the width")
        return self
