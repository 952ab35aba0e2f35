"""Stay in a box for ever."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Bools, Floats
from simgap.config.base import Interval
from simgap.geometry import Box
from simgap.specifications.base import Always, Game, Look, Monitor, Specification, Words, projected, rectangle
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space, inner_box, unbounded


class Invariance(Specification):
    """Stay in the safe set for ever, at the sampling instants."""

    kind: Literal["invariance"]
    """Stay in the safe set for ever."""
    safe: dict[str, Interval] = Field(default_factory=dict)
    """For each state the interval to stay in; states not named keep all of X."""

    on_true_cells: ClassVar[bool] = True
    words: ClassVar[Words] = Words(
        runs="Runs against the safe set",
        caption="One run of each controller in the simulator (in colour) and from the same start on the nominal model "
        "(grey, dashed). Both promise to stay between the green lines.",
        kept="safe",
        allowed="safe set",
        promise="stays safe for ever",
        violated="leaves the safe set",
        failed="left the safe set",
        limits="safe set",
    )

    def region(self, space: Space) -> Box:
        """The safe set."""
        return inner_box(self.safe, space.states, space.box, "safe")

    def solve(self, game: Game) -> Solution:
        """The maximal controlled invariant set in the region."""
        return game.invariant(np.ones(game.grid.size, np.bool_))

    def monitor(self, space: Space, solution: Solution) -> Monitor:
        """Monitor of samples in the safe set."""
        region = self.region(space)
        return Inside(unbounded(region, space.wrapping(region)))

    def sentence(self, space: Space) -> str:
        """'stay for ever in ...'."""
        named = ", ".join(space.interval(name, ends) for name, ends in self.safe.items())
        return f"stay for ever in {named or 'X'}"

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """The border of the safe set."""
        box = projected(self.region(space), space.box, shown)
        rectangle(axes, box, facecolor="none", edgecolor=look.border, lw=1.2, label="safe set")


@dataclass(frozen=True, eq=False)
class Inside(Always):
    """Every sample must be in a box."""

    box: Box

    violated = "left the safe set"

    def satisfied(self, x: Floats) -> Bools:
        """True where states are in the box: (n, nx) -> (n,)."""
        return self.box.contains(x)

    def over(self, x: Floats, measured: Floats) -> bool:
        """A run ends outside, at `x` (nx,); without arrays, because this is asked at every sample."""
        lo, hi = self._ends
        return any(not a <= value <= b for a, value, b in zip(lo, x.tolist(), hi, strict=True))

    @cached_property
    def _ends(self) -> tuple[list[float], list[float]]:
        return self.box.lo.tolist(), self.box.hi.tolist()
