"""The sections `grid`, `gap`, `symmetry` and `hidden_state`: where the gap is sampled, and how it is bounded.

The built-in bases of `gap.basis` are in `simgap/gap/bases.py`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from simgap.config.base import Interval, NotNegative, Positive, Section
from simgap.config.plugged import Plugged
from simgap.geometry import Box


class BasisSection(Section):
    """A basis is a section of a case, its options, that lists its terms: a plug-in of the group `bases`, one a file."""

    kind: str
    """Which basis: a built-in one, one that an installed distribution offers, or file.py:Class for a class in a file
    beside the case."""

    @abstractmethod
    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """The terms as expressions over the names of states and inputs, twice differentiable in the states.

        Args:
            states, inputs: their names, in order.
            domain: the box X of the states, for terms that depend on its size.
        """


class GridSection(Section):
    """States that cover X, and how the roll-outs are cut into files."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("half_widths",)

    eps: float | None = Field(None, gt=0)
    """Radius of the balls around samples: no cell's half-diagonal is longer."""
    half_widths: dict[str, Positive] = Field(default_factory=dict)
    """Instead of eps: for each state half the width of a cell, in its unit; states along which a translation is
    declared (`symmetry`) need none."""
    shards: int = Field(2, ge=1, le=1000)
    """Files (and jobs) that the roll-outs are split into."""

    @model_validator(mode="after")
    def _one_of_both(self) -> GridSection:
        if (self.eps is None) == (not self.half_widths):
            raise ValueError("a grid has either eps or half_widths: give one of them")
        return self


class SymmetrySection(Section):
    """Symmetry of the gap: no dependence on position and heading (SE(2)), or on some states; measured, not believed."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("along",)

    group: Literal["planar", "translation"] = "planar"
    """planar: position and heading of `plant.symbolic.wheels`. translation: the gap does not depend on the states
    `along`, such as where a cart stands."""
    along: tuple[str, ...] = ()
    """translation: the states on which the gap does not depend."""
    headings: int = Field(8, ge=1)
    """Random headings (or shifts) at which each checked history is repeated."""
    histories: int = Field(100, ge=1)
    """Random histories (or states) that are repeated at each."""
    tolerance: dict[str, float]
    """For each state the largest deviation between headings (or shifts); above it the stage fails."""
    seed: int = Field(3, ge=0)
    """Seed of histories and headings."""

    @model_validator(mode="after")
    def _along_what(self) -> SymmetrySection:
        if (self.group == "translation") != bool(self.along):
            raise ValueError("a translation, and nothing else, is `along` states: name them there")
        if self.along and self.headings < 3:
            raise ValueError("a translation is measured at both ends of X and between: headings is at least 3")
        return self


class HiddenStateSection(Section):
    """State that earlier inputs leave behind in the simulator, and how it is covered."""

    previous: dict[str, int]
    """For each input, how many of its values represent the previous input: the extremes, and values between."""
    classes: dict[str, int] = Field(default_factory=dict)
    """For each input, the number of intervals that divide the previous input into classes: the bound is taken for each
    class, and the controller remembers the class. None: one class, no memory."""
    length: int = Field(4, ge=1)
    """Longest histories that are tried, in inputs before the present one; the bound must stop growing by then."""
    chains: int = Field(40, ge=2)
    """Random input sequences that look for what the previous inputs missed."""
    chain_length: int = Field(500, ge=10)
    """Samples in each of these sequences."""
    growth: float = Field(0.1, gt=0)
    """Growth of the bound with longer histories, relative to its sup, up to which it counts as settled."""
    seed: int = Field(2, ge=0)
    """Seed of the random input sequences."""
    fresh_samples: int = Field(20_000, ge=1)
    """Steps of other random sequences, five each, on which the bound is checked; they are not used in any bound."""
    fresh_seed: int = Field(11, ge=0)
    """Seed of the fresh sequences."""
    search: int = Field(2000, ge=0)
    """Steps of a directed search over histories and headings that widens the bound, and as many steps of a second
    search that must not break it. 0 turns both off."""
    tolerated_probability: float = Field(0.0, ge=0.0, lt=1.0)
    """Largest bound of the violation probability; 0: one violation fails the stage."""

    @model_validator(mode="after")
    def _fresh_is_fresh(self) -> HiddenStateSection:
        if self.fresh_seed == self.seed:
            raise ValueError(f"fresh_seed and seed are both {self.seed}: the check would see what made the bound")
        return self


class LipschitzSection(Section):
    """Lipschitz estimates."""

    rough_limit: float = Field(0.1, ge=0.0, le=1.0)
    """Largest share of the cells in which the gap may jump (padding inflate covers them by the jump seen there); more
    is refused."""
    extreme_value: bool = True
    """Also compute the paper's extreme-value estimates, for comparison."""


class NoiseSection(Section):
    """Statement that the bound makes of a simulator with noise; without noise nothing of it is used."""

    alpha: float = Field(0.001, ge=1e-8, lt=0.5)
    """Probability with which a step may lie outside, at any state and input; a run of N steps keeps its promise with a
    probability of at least (1 - alpha)^N."""
    confidence: float = Field(0.99, gt=0.5, le=1.0 - 1e-8)
    """Confidence that this holds at all samples together. Both set how often each sample is repeated."""


class RemainderWithin(Section):
    """More is left in a part of X."""

    where: dict[str, Interval] = Field(min_length=1)
    """For a state, from and to, in its unit; states that are not named are free."""
    by: dict[str, NotNegative]
    """For a state, the remainder there in one step, in its unit."""


class GapSection(Section):
    """Bound of the gap d = simulator - nominal on all of X x U, and its check."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("remainder_within", "noise")

    basis: Annotated[BasisSection, Plugged("bases", "kind", listed=("expressions", "terms"))]
    """Terms of the bound as expressions over states and inputs, such as [x1^2, x1*x2, u, 1]; or a kind with options,
    such as {kind: monomials, degree: 2}."""
    objective: Literal["lexicographic", "eta"] = "lexicographic"
    """eta: the smallest supremum (the paper). lexicographic: the smallest mean among bounds whose supremum is at most
    `slack` of the largest gap above the smallest one."""
    slack: float = Field(0.01, ge=0.0, le=1.0)
    """See objective; a share of the largest sampled gap."""
    sides: Literal["signed", "unsigned"] = "signed"
    """signed: lower and upper bound fitted separately. unsigned: |d| <= gamma (the paper)."""
    padding: Literal["inflate", "per_axis", "paper"] = "inflate"
    """How the bound is carried from samples to all states: inflate: local Lipschitz constants of the residual inside
    the program. per_axis: sum_j (L1_j + L2_j) h_j. paper: (L1 + L2) eps."""
    tolerated_probability: float = Field(0.0, ge=0.0, lt=1.0)
    """0: one violation among the fresh samples fails the stage. Otherwise the Clopper-Pearson bound of the violation
    probability may reach this value, and it is printed in the headline."""
    fresh_samples: int = Field(300_000, ge=1)
    """Random off-grid samples for the check, never used in the fit."""
    remainder: dict[str, NotNegative] = Field(default_factory=dict)
    """For a state, the one-step error that measured data leave unexplained, in its unit. It is added on both sides
    of the bound, which then covers the hardware and not only the simulator. `simgap diagnose` writes it."""
    remainder_within: tuple[RemainderWithin, ...] = ()
    """Boxes of the states in which more is left, such as near rest, where dry friction sticks; in cells that a box
    touches, its numbers replace `remainder` where they are larger. A bound that is not a table of cells takes them
    everywhere."""
    confidence: float = Field(0.95, gt=0.5, lt=1.0)
    """Confidence of the Clopper-Pearson bound."""
    lipschitz: LipschitzSection = LipschitzSection()
    """How Lipschitz constants are estimated."""
    noise: NoiseSection = NoiseSection()
    """What the bound promises of a simulator with noise."""
    seed: int = Field(1, ge=0)
    """Seed of the fresh samples and of everything random in the fit."""

    @property
    def signed(self) -> bool:
        """True if the two sides are fitted separately."""
        return self.sides == "signed"
