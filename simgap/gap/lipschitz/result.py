"""Lipschitz constants of one dimension of the gap, and where the grid does not resolve it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.json_record import JsonRecord
from simgap.gap.thresholds import EVERYWHERE, GATE, THIN


@dataclass(frozen=True)
class Layer(JsonRecord):
    """Cells between lo and hi along an axis, of which the share `rough` is rough, and clearly fewer beside them."""

    axis: int
    lo: float
    hi: float
    rough: float

    @property
    def middle(self) -> float:
        """Between lo and hi; 0 if it is that but for rounding."""
        middle = 0.5 * (self.lo + self.hi)
        return middle if abs(middle) > 1e-9 * (self.hi - self.lo) else 0.0


@dataclass(frozen=True, eq=False)
class GridLipschitz(
    JsonRecord,
    names={"smooth": "without_rough_cells", "jump": "largest_jump", "layers": "rough_layers", "at": "largest_jump_at"},
):
    """Per-axis estimate for one dimension of the gap.

    Attributes:
        constants: (nx,) largest slope plus change of slope along each axis; 0 along free axes.
        slopes: (nx,) largest slope alone. ratio: (nx,) resolution ratio, also taken at twice the spacing.
        euclidean: estimate of the constant in the Euclidean norm, sqrt(sum_j L_j^2).
        smooth: as `constants`, without the rough cells. rough_share: share of the cells that are rough.
        rough_box: (2, nx) box that holds the rough cells, or None. jump: largest spread of neighbours there.
        proven: whether the constants are bounds, enclosed on every cell, and no estimates.
        layers: where rough cells crowd along an axis though others lie elsewhere. at: (nx,) the centre of the cell with
            the largest jump.
    """

    constants: Floats
    slopes: Floats
    ratio: Floats
    smooth: Floats
    rough_share: float
    rough_box: Floats | None
    jump: float
    proven: bool = False
    layers: tuple[Layer, ...] = ()
    at: Floats | None = None

    @property
    def euclidean(self) -> float:
        """sqrt(sum_j L_j^2)."""
        return float(np.linalg.norm(self.constants))

    @property
    def resolved(self) -> bool:
        """True if the grid resolves the slope along every axis."""
        return bool(np.all(self.ratio <= GATE))

    def place(self, states: Sequence[str], lo: Floats, hi: Floats) -> str:
        """Sentence on where the gap jumps, by how much, and the usual cause; lo, hi (nx,) are the ends of X."""
        ratios = ", ".join(f"{r:.2f} along {s}" for s, r in zip(states, self.ratio, strict=True) if r > GATE)
        seen = ratios or "in what the basis leaves"
        if self.rough_box is None:
            return f"the gap has no jump, it bends faster than the grid sees ({seen})"
        low, high = self.rough_box
        thin = [j for j in range(len(states)) if high[j] - low[j] < THIN * (hi[j] - lo[j])]
        if not thin and self.layers:
            return self._crowded(states)
        if not thin and self.rough_share > EVERYWHERE:
            return f"that is so almost everywhere: no jump, the cells are too few to follow the gap ({seen})"
        ends = [f"{low[j]:.3g} < {states[j]} < {high[j]:.3g}" for j in (thin or range(len(states)))]
        found = f"the gap jumps by up to {self.jump:.3g} where {' and '.join(ends)}"
        if thin:
            at = ", ".join(f"{states[j]} = {0.5 * (low[j] + high[j]):.3g}" for j in thin)
            found += f": something switches near {at}, such as dry friction at rest, a contact or a stop"
        return found

    def _crowded(self, states: Sequence[str]) -> str:
        """Several things that switch, each near one value of a state: two joints with dry friction, say."""
        where = [f"{o.lo:.3g} < {states[o.axis]} < {o.hi:.3g} ({100 * o.rough:.0f} %)" for o in self.layers]
        near = " and near ".join(f"{states[o.axis]} = {o.middle:.3g}" for o in self.layers)
        spot = ", ".join(f"{s} = {v:.3g}" for s, v in zip(states, self.at if self.at is not None else (), strict=False))
        largest = f", the largest beside {spot}" if spot else ""
        return (
            f"the gap jumps by up to {self.jump:.3g}{largest}; most cells are rough where {' or '.join(where)}: "
            f"something switches near {near}, such as dry friction at rest, a contact or a stop"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data, with what follows from the constants."""
        own = super().to_json()
        constants = {"constants": own.pop("constants"), "euclidean": self.euclidean}
        slopes = {"slopes": own.pop("slopes"), "ratio": own.pop("ratio"), "resolved": self.resolved}
        return constants | slopes | own


def worse(a: GridLipschitz, b: GridLipschitz) -> GridLipschitz:
    """Number by number the larger of two estimates: what holds for both; a box around both their rough cells."""
    boxes = [box for box in (a.rough_box, b.rough_box) if box is not None]
    hull = (
        np.stack([np.min([lo for lo, _ in boxes], axis=0), np.max([hi for _, hi in boxes], axis=0)]) if boxes else None
    )
    constants, slopes, ratio, smooth = (
        np.maximum(getattr(a, name), getattr(b, name)) for name in ("constants", "slopes", "ratio", "smooth")
    )
    return GridLipschitz(constants, slopes, ratio, smooth, max(a.rough_share, b.rough_share), hull, max(a.jump, b.jump))


@dataclass(frozen=True)
class LipschitzRow(JsonRecord):
    """One estimate of the Euclidean constant: method, value, p-value of its goodness of fit (None: no fit), note."""

    method: str
    value: float
    ks_p: float | None
    note: str


@dataclass(frozen=True, eq=False)
class DimensionLipschitz(
    JsonRecord,
    kind="slopes",
    names={"grid": "lipschitz", "estimates": "lipschitz_estimates", "largest": "largest_sampled_gap"},
):
    """Grid estimate of one dimension, the estimates side by side, and the largest sampled |d| (the scale of both)."""

    grid: GridLipschitz
    estimates: tuple[LipschitzRow, ...]
    largest: float
