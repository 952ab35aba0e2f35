"""The `grid` section: where nominal model and simulator are compared."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from simgap.config.base import Section


class GridSection(Section):
    """States that cover X, and how the roll-outs are cut into files."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("half_widths",)

    eps: float | None = Field(
        None, gt=0, description="Radius of the balls around samples: no cell's half-diagonal is longer."
    )
    half_widths: dict[str, float] = Field(
        default_factory=dict,
        description="Instead of eps: for each state half the width of a cell, in its unit; states along which a "
        "translation is declared (`symmetry`) need none.",
    )
    shards: int = Field(2, ge=1, le=1000, description="Files (and jobs) that the roll-outs are cut into.")

    @model_validator(mode="after")
    def _one_of_both(self) -> GridSection:
        if (self.eps is None) == (not self.half_widths):
            raise ValueError("a grid has either eps or half_widths: give one of them")
        bad = [name for name, value in self.half_widths.items() if not value > 0]
        if bad:
            raise ValueError(f"the half-width of {bad} is not positive")
        return self
