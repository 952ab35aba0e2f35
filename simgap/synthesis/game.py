"""The game on an abstraction: the operators that specifications are solved by, whatever the controller may measure.

With a perfect measurement, and for whatever is to be reached, cells are of the measured state: a box of successors
holds every state that may be measured there. What is only to be held is better solved on cells of the true state, with
what the controller cannot tell apart taken into account afterwards (`sensing`); that also allows a sample of latency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Floats, Grid
from simgap.specifications.regions import Mask
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.invariance import invariance
from simgap.synthesis.reach import reach_avoid
from simgap.synthesis.sensing import sensed_invariance
from simgap.synthesis.windows import margins, window_and


@dataclass(frozen=True, eq=False)
class MeasuredGame:
    """The game on cells of the measured state.

    Attributes:
        space: the states; abstraction: its boxes account for its `error`.
        stray: how far a path strays from its samples where clearance is to cover that, (nx,).
        threads: for the kernels.
    """

    space: Space
    abstraction: Abstraction
    stray: Floats
    threads: int = 1

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.abstraction.grid

    @property
    def error(self) -> Floats:
        """The measurement error, (nx,)."""
        return self.abstraction.error

    def invariant(self, safe: Mask) -> Solution:
        """The greatest fixed point of the controlled predecessor within the safe cells, (cells,) bool."""
        if self.abstraction.swept is not None:
            raise BrokenPromise("swept boxes are not checked by the invariance kernel", "Let the clearance cover them.")
        found = invariance(self.abstraction, None if safe.all() else safe, self.threads)
        return Solution(
            grid=self.grid,
            winning=self._starts(found.winning),
            mask=found.mask,
            free=safe,
            statistics={"passes": found.passes, "pairs": found.pairs},
        )

    def reach(self, target: Mask, free: Mask) -> Solution:
        """The least fixed point, its value function and all inputs that go down a level; sets are (cells,) bool."""
        found = reach_avoid(self.abstraction, target, free, self.threads)
        return Solution(
            grid=self.grid,
            winning=self._starts(found.winning),
            mask=found.mask,
            free=free,
            value=found.value,
            target=target & free,
            statistics={"steps": found.steps, "backend": found.backend},
        )

    def _starts(self, winning: Mask) -> Mask:
        """True cells whose every measurement is in a winning cell; a measurement beyond the grid is in none."""
        margin = margins(self.grid, self.error)
        if not any(margin):
            return winning
        inside = winning.reshape(self.grid.cells).copy()
        for j, m in enumerate(margin):
            if m and j not in self.grid.periodic:
                ends = np.moveaxis(inside, j, 0)
                ends[:m], ends[-m:] = False, False
        kept = window_and(winning.astype(np.uint32)[:, None], self.grid, margin)[:, 0] == 1
        return np.asarray(kept & inside.reshape(-1))


@dataclass(frozen=True, eq=False)
class TrueGame:
    """The game on cells of the true state, of which the controller knows a measurement: it can only hold sets.

    Attributes:
        space: the states; abstraction: without measurement error.
        blur: bound of the measurement error, (nx,); latency: whole samples between a measurement and its input.
        stray, threads: as for `MeasuredGame`.
    """

    space: Space
    abstraction: Abstraction
    blur: Floats
    latency: int
    stray: Floats
    threads: int = 1

    @property
    def grid(self) -> Grid:
        """Cells of the true state."""
        return self.abstraction.grid

    @property
    def error(self) -> Floats:
        """None, (nx,) zeros: the cells are those of the state itself."""
        return np.zeros(self.space.size)

    def invariant(self, safe: Mask) -> Solution:
        """A controlled invariant set in (cells,) that measurements suffice to keep; sound, not always the largest."""
        return sensed_invariance(self.abstraction, self.blur, self.latency, self.threads, safe)

    def reach(self, target: Mask, free: Mask) -> Solution:
        """Not on these cells, whatever the sets, (cells,) bool each.

        Raises:
            UserError: always.
        """
        raise UserError(
            "a specification that carries a pending input cannot reach anything yet",
            key="synthesis.specification",
            remedy="Let its carries_pending be False.",
        )
