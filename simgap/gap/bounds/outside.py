"""Where a gap lies furthest outside its bound: which state, which place, by how much, and what gamma says there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats


@dataclass(frozen=True)
class Outside:
    """One gap that its bound does not cover.

    Attributes:
        state: whose gap it is. excess: by how much it lies outside, in the unit of the state.
        gap: simulator minus model there; lower, upper: the bound there.
        at: value of each state and input there.
    """

    state: str
    excess: float
    gap: float
    lower: float
    upper: float
    at: dict[str, float]

    def __str__(self) -> str:
        """In words for a message."""
        place = ", ".join(f"{name} = {value:.4g}" for name, value in self.at.items())
        return (
            f"the worst in {self.state} at {place}, where the gap is {self.gap:.4g} and gamma "
            f"[{self.lower:.4g}, {self.upper:.4g}], by {self.excess:.2g}"
        )


def worst_outside(
    names: tuple[Sequence[str], Sequence[str]], x: Floats, u: Floats, d: tuple[Floats, Floats], lo: Floats, hi: Floats
) -> Outside | None:
    """The gap that lies outside by the largest share of its bound's width; None if all lie inside.

    Args:
        names: of states and inputs.
        x, u: (n, nx), (n, nu) places. d: least and largest gap there, (n, nx) each. lo, hi: (n, nx) the bound there.
    """
    below, above = lo - d[0], d[1] - hi
    excess = np.maximum(below, above)
    if not (excess > 0.0).any():
        return None
    share = np.where(excess > 0.0, excess / np.maximum(hi - lo, np.finfo(float).tiny), -np.inf)
    k, i = (int(index) for index in np.unravel_index(int(np.argmax(share)), share.shape))
    gap = d[0][k, i] if below[k, i] >= above[k, i] else d[1][k, i]
    at = dict(zip((*names[0], *names[1]), map(float, (*x[k], *u[k])), strict=True))
    return Outside(names[0][i], float(excess[k, i]), float(gap), float(lo[k, i]), float(hi[k, i]), at)
