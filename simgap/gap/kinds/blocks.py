"""The basis of indicator functions of blocks of X: the one that no expression writes, see `cell_fit`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from simgap.config.gap import BasisSection
from simgap.geometry import Box


class Blocks(BasisSection):
    """A value for each block of X, and for each input or for all of them."""

    kind: Literal["blocks"] = Field("blocks", description="Which basis.")
    blocks: tuple[int, ...] | None = Field(
        None, description="Number of blocks along each state axis; without it 8, or as many as the grid has cells."
    )
    per_input: bool = Field(True, description="A value for each input (true) or one for all inputs.")

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """The constant: what is left of blocks where a bound is linear in expressions."""
        return ("1",)
