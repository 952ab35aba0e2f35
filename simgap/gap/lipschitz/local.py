"""How far the residual `e = t - q.p` of a fit may exceed its sample inside a cell.

t, what a side of the bound has to cover, is known at the cell centres alone, so its slope is estimated there: the
differences to both neighbours, and the change of slope. The slope and curvature of q.p are known, and never estimated:

    pad_r = sum_j h_j max over the cell and its neighbours of ( |slope_j t - d_j q.p| + |change of slope_j t| )
            + 1/2 sum_jk H_jk h_j h_k,                                      H_jk >= |d_jk q.p| on X x U.

Where the grid does not resolve t or e (a jump), t is taken to stay within the values of the neighbouring samples,
and the padding is at least that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from simgap.gap.lipschitz.grid import (
    Mask,
    as_grid,
    modes,
    moving_axes,
    pieces,
    rough_cells,
    steps,
    to_cells,
    turns,
    window,
)
from simgap.geometry import Floats, Grid


@dataclass(frozen=True, eq=False)
class Beside:
    """Where samples beside the grid lie: their cells (E,), and which coordinates a border or surface fixes, (E, nx)."""

    cells: NDArray[np.int64]
    fixed: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LocalPadding:
    """Local paddings of one target t (N, M) on a grid; `floor` is the size of differences that are rounding alone."""

    target: Floats
    grid: Grid
    free: tuple[int, ...]
    floor: float

    @cached_property
    def axes(self) -> tuple[int, ...]:
        """Axes along which the gap may change."""
        return moving_axes(self.grid, self.free)

    @cached_property
    def _field(self) -> Floats:
        return as_grid(self.target, self.grid)

    @cached_property
    def _rough(self) -> Mask:
        return rough_cells(self._field, self.grid, self.axes, self.floor)

    def of_target(self) -> tuple[Floats, float]:
        """Padding of t itself (q = 0): (N, M), and the share of rough cells."""
        return self.of_residual(np.zeros_like(self.target), lambda j: np.zeros((1, 1)), np.zeros((0, 0)))

    def along(
        self, beside: Beside, slope: Callable[[int], Floats] | None = None, curvature: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """How far t - q.p may move from samples beside the grid: -> along their surface, across it; (E, M) each.

        Along the surface they stand for half a cell on either side. What the residual does across it, between the
        centre of their cell and themselves, they show; the second number is what the slopes there allow.
        """
        bend, count = self._bend(curvature), (len(beside.cells), self.target.shape[1])
        rows = {j: np.empty(count) for j in self.axes}
        for inputs in pieces(self._field):
            for j, part in self._parts(slope or (lambda j: np.zeros((1, 1))), inputs):
                rows[j][inputs] = part.reshape(self.grid.size, -1)[beside.cells]
        moved, held = np.zeros((len(beside.cells), self.target.shape[1])), np.zeros((1, 1))
        for j, own in rows.items():
            moved = moved + np.where(beside.fixed[:, [j]], 0.0, own)
            held = held + np.where(beside.fixed[:, [j]], own, 0.0)
        return moved + bend, held + bend

    def _bend(self, curvature: Floats | None) -> float:
        moving = np.array([h if j in self.axes else 0.0 for j, h in enumerate(self.grid.h)])
        return 0.5 * float(moving @ curvature @ moving) if curvature is not None and curvature.size else 0.0

    def _of(self, values: Floats, inputs: tuple[EllipsisType, slice]) -> Floats:
        """What broadcasts to (N, M), for some inputs, as `_field`."""
        some: Floats = np.broadcast_to(values, self.target.shape)[inputs]
        return some.reshape(*self._field.shape[:-1], -1)

    def _parts(
        self, slope: Callable[[int], Floats], inputs: tuple[EllipsisType, slice]
    ) -> Iterator[tuple[int, Floats]]:
        """What each axis adds to the padding for some inputs, as `_field`."""
        for j in self.axes:
            expected = self._of(slope(j) * 2.0 * self.grid.h[j], inputs)
            step = steps(self._field[inputs], j, self.grid)
            turned = turns(step, j, self.grid, self.axes)
            yield j, 0.5 * self._widest(to_cells(step, j, self.grid, expected) + turned)

    def of_residual(self, values: Floats, slope: Callable[[int], Floats], curvature: Floats) -> tuple[Floats, float]:
        """Padding of t - q.p, from q.p (N, M), its slopes there and H (nx, nx): (N, M) and the share of rough cells."""
        grid, bend, pad = self.grid, self._bend(curvature), np.zeros_like(self._field)
        for inputs in pieces(pad):
            for _, part in self._parts(slope, inputs):
                pad[inputs] += part
        pad += bend
        residual = self._field - values.reshape(self._field.shape)
        rough = self._rough | rough_cells(residual, grid, self.axes, self.floor, split=False)  # t has the jumps
        if rough.any():
            usual = max(float(pad[some][~rough[some]].max(initial=0.0)) for some in pieces(pad))
            for inputs in pieces(pad):
                own = np.zeros_like(pad[inputs])
                for j in self.axes:
                    own += self._of(np.abs(slope(j)) * grid.h[j], inputs)
                left, field, where = residual[inputs], self._field[inputs], rough[inputs]
                straight = self._widest(left)[where] - left[where] + 5.0 * bend
                flat = self._widest(field)[where] - field[where] + own[where] + bend
                some = pad[inputs]
                some[where] = np.maximum(some[where], np.minimum(straight, flat) + usual)
        return pad.reshape(self.target.shape), float(rough.mean())

    def _widest(self, values: Floats) -> Floats:
        return np.asarray(maximum_filter(values, size=window(self.grid, self.axes), mode=modes(self.grid)))
