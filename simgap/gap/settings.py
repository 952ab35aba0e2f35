"""Settings of a fit of the gap bound; the case file's `gap` section maps onto them."""

from __future__ import annotations

from dataclasses import dataclass, field

from simgap.config.gap import BasisSection, GapSection
from simgap.errors import UserError
from simgap.gap.bases import Monomials

OBJECTIVES = ("lexicographic", "eta")
SIDES = ("signed", "unsigned")
PADDINGS = ("inflate", "per_axis", "paper")
BOUNDS = ("scenario", "conformal", "envelope", "constant")


@dataclass(frozen=True)
class GapSettings:
    """Settings of a fit of the gap bound.

    Attributes:
        basis: lists its terms; `Blocks` are fitted for themselves.
        objective, sides, padding, bound: one of OBJECTIVES, SIDES, PADDINGS, BOUNDS.
        slack: by how much of the largest sampled gap the supremum may exceed its optimum to lower the mean.
        rough_limit: largest share of cells in which the gap may jump; more is refused.
        miscoverage: of the conformal bound. envelope_nodes: most numbers in an envelope's table.
        extreme_value: whether the paper's estimates are computed for comparison; pairs, repeats: their size.
        seed: of everything random in the fit.
    """

    basis: BasisSection = field(default_factory=Monomials)
    objective: str = "lexicographic"
    sides: str = "signed"
    padding: str = "inflate"
    bound: str = "scenario"
    slack: float = 0.01
    rough_limit: float = 0.1
    miscoverage: float = 0.01
    envelope_nodes: int = 200_000
    extreme_value: bool = True
    extreme_value_blocks: int = 100
    extreme_value_pairs: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        for key, known in (("objective", OBJECTIVES), ("sides", SIDES), ("padding", PADDINGS), ("bound", BOUNDS)):
            value = getattr(self, key)
            if value not in known:
                raise UserError(f"there is no {key} '{value}'", key=f"gap.{key}", remedy=f"Known: {', '.join(known)}.")

    @staticmethod
    def of(section: GapSection) -> GapSettings:
        """The settings that a case's `gap` section asks for."""
        return GapSettings(
            basis=section.basis,
            objective=section.objective,
            sides=section.sides,
            padding=section.padding,
            bound=section.bound,
            slack=section.slack,
            rough_limit=section.lipschitz.rough_limit,
            miscoverage=section.conformal.miscoverage,
            envelope_nodes=section.envelope_nodes,
            extreme_value=section.lipschitz.extreme_value,
            extreme_value_blocks=section.lipschitz.extreme_value_blocks,
            extreme_value_pairs=section.lipschitz.extreme_value_pairs,
            seed=section.seed,
        )

    @property
    def signed(self) -> bool:
        """True if the two sides are fitted separately."""
        return self.sides == "signed"
