"""Lipschitz estimates from the grid that is there: slopes between neighbours, and whether the grid resolves them.

Along axis j with spacing s = 2 h, a sample's slope is the larger of the differences to its two neighbours, over s; its
change of slope is the second difference over s. The estimate of a constant is the largest slope plus change of slope.
It is an *estimate*: samples cannot prove a bound between them. The resolution ratio L(s) / L(2 s) tells whether the
grid sees the steepest part: above `GATE` it does not, and the constant must not be used, unless the steep cells are few
and are covered by the jump seen there (`rough_cells`), as with Coulomb friction at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from simgap.errors import UserError
from simgap.geometry import Floats, Grid

GATE = 1.3
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class GridLipschitz:
    """Per-axis estimate for one dimension of the gap.

    Attributes:
        constants: (nx,) largest slope plus change of slope along each axis; 0 along free axes.
        slopes: (nx,) largest slope alone. ratio: (nx,) L(s) / L(2 s).
        euclidean: estimate of the constant in the Euclidean norm, sqrt(sum_j L_j^2).
        smooth: as `constants`, without the rough cells. rough_share: share of the cells that are rough.
        rough_box: (2, nx) box that holds the rough cells, or None. jump: largest spread of neighbours there.
    """

    constants: Floats
    slopes: Floats
    ratio: Floats
    smooth: Floats
    rough_share: float
    rough_box: Floats | None
    jump: float

    @property
    def euclidean(self) -> float:
        """sqrt(sum_j L_j^2)."""
        return float(np.linalg.norm(self.constants))

    @property
    def resolved(self) -> bool:
        """Whether the grid resolves the slope along every axis."""
        return bool(np.all(self.ratio <= GATE))

    def to_json(self) -> dict[str, Any]:
        """Everything as plain data."""
        box = None if self.rough_box is None else self.rough_box.tolist()
        return {
            "constants": self.constants.tolist(), "euclidean": self.euclidean, "slopes": self.slopes.tolist(),
            "ratio": self.ratio.tolist(), "resolved": self.resolved, "without_rough_cells": self.smooth.tolist(),
            "rough_share": self.rough_share, "rough_box": box, "largest_jump": self.jump,
        }  # fmt: skip


def estimate(d: Floats, grid: Grid, free: tuple[int, ...] = (), floor: float = 0.0) -> GridLipschitz:
    """Per-axis estimate from values (N, M) at the cell centres; differences up to `floor` count as rounding.

    Raises:
        UserError: with fewer than four cells along an axis that is not free.
    """
    e = as_grid(d, grid)
    axes = moving_axes(grid, free)
    rough = rough_cells(e, grid, axes, floor)
    nx = len(grid.cells)
    constants, slopes, ratio, smooth = np.zeros(nx), np.zeros(nx), np.ones(nx), np.zeros(nx)
    for j in axes:
        step, s = _steps(e, j, grid), 2.0 * grid.h[j]
        first, second = _to_cells(step, j, grid), _bends(step, j, grid)
        local = (first + second) / s
        constants[j], slopes[j] = local.max(), first.max() / s
        wide = np.abs(_double_steps(e, j, grid)).max() / (2.0 * s)
        ratio[j] = slopes[j] / wide if slopes[j] * s > floor else 1.0
        smooth[j] = local[~rough].max(initial=0.0)
    share, box, jump = float(rough.mean()), None, 0.0
    if rough.any():
        low, high = _spread(e, grid, axes)
        jump = float((high - low)[rough].max())
        places = grid.centres()[rough.reshape(grid.size, -1).any(axis=1)]
        box = np.stack([places.min(axis=0) - grid.h, places.max(axis=0) + grid.h])
    return GridLipschitz(constants, slopes, ratio, smooth, share, box, jump)


def local_padding(e: Floats, grid: Grid, free: tuple[int, ...], floor: float) -> tuple[Floats, float]:
    """(N, M) estimate of how far e exceeds its sample anywhere in the cell, and the share of rough cells.

    Smooth cells: `sum_j L_rj h_j`, slope plus change of slope, each the largest of the cell and its neighbours.
    Rough cells: at least the largest neighbour's value, plus the padding of the smooth cells.
    """
    field = as_grid(e, grid)
    axes = moving_axes(grid, free)
    size, mode = _window(grid, axes), _modes(grid)
    rough = rough_cells(field, grid, axes, floor)
    pad = np.zeros_like(field)
    for j in axes:
        step = _steps(field, j, grid)
        slope = _to_cells(step, j, grid) + _bends(step, j, grid)
        pad += 0.5 * maximum_filter(slope, size=size, mode=mode)
    if rough.any():
        usual = float(pad[~rough].max(initial=0.0))
        over = maximum_filter(field, size=size, mode=mode) - field
        pad[rough] = np.maximum(pad[rough], over[rough] + usual)
    return pad.reshape(e.shape), float(rough.mean())


def rough_cells(e: Floats, grid: Grid, axes: tuple[int, ...], floor: float) -> Mask:
    """Cells around differences that the grid does not resolve: outside them, L(s) / L(2 s) <= GATE along every axis.

    Steep differences are taken out, steepest first, until the ratio of the rest passes; the cells on both sides and
    their neighbours are rough. Differences up to `floor` never are.
    """
    rough = np.zeros(e.shape, dtype=bool)
    for j in axes:
        step = np.abs(_steps(e, j, grid))
        wide = 0.5 * np.abs(_double_steps(e, j, grid))
        out = np.zeros(step.shape, dtype=bool)
        while True:
            fine = step[~out].max(initial=0.0)
            broad = wide[~_pairs(out, j, grid)].max(initial=0.0)
            if fine <= max(GATE * broad, floor):
                break
            out |= step > max(GATE * broad, 0.5 * fine, floor)
        rough |= _to_cells(out, j, grid) > 0
    if not rough.any():
        return rough
    wider = maximum_filter(rough.view(np.uint8), size=_window(grid, axes), mode=_modes(grid))
    return np.asarray(wider > 0)


def as_grid(d: Floats, grid: Grid) -> Floats:
    """(N, M) -> (cells_1, ..., cells_nx, M)."""
    return np.ascontiguousarray(d).reshape(*grid.cells, -1)


def moving_axes(grid: Grid, free: tuple[int, ...]) -> tuple[int, ...]:
    """Axes along which the gap may change; each needs four cells."""
    axes = tuple(j for j in range(len(grid.cells)) if j not in free)
    for j in axes:
        if grid.cells[j] < 4:
            raise UserError(
                f"axis {j + 1} of the sampling grid has {grid.cells[j]} cells, too few for a Lipschitz estimate",
                key="grid.eps",
                remedy="Use a smaller eps (at least 4 cells along each axis).",
            )
    return axes


def _steps(e: Floats, j: int, grid: Grid) -> Floats:
    """Differences of neighbours along axis j; a periodic axis has one more, over the seam."""
    if j in grid.periodic:
        return np.roll(e, -1, axis=j) - e
    return np.diff(e, axis=j)


def _double_steps(e: Floats, j: int, grid: Grid) -> Floats:
    if j in grid.periodic:
        return np.roll(e, -2, axis=j) - e
    n = e.shape[j]
    return np.take(e, range(2, n), axis=j) - np.take(e, range(n - 2), axis=j)


def _pairs(out: Mask, j: int, grid: Grid) -> Mask:
    """Double steps that contain a step of `out`."""
    if j in grid.periodic:
        return out | np.roll(out, -1, axis=j)
    n = out.shape[j]
    return np.take(out, range(n - 1), axis=j) | np.take(out, range(1, n), axis=j)


def _to_cells(step: Floats | Mask, j: int, grid: Grid) -> Floats:
    """Larger of the absolute differences on both sides of each cell."""
    size = np.abs(step)
    if j in grid.periodic:
        return np.maximum(size, np.roll(size, 1, axis=j))
    first, last = np.take(size, [0], axis=j), np.take(size, [-1], axis=j)
    return np.maximum(np.concatenate([first, size], axis=j), np.concatenate([size, last], axis=j))


def _bends(step: Floats, j: int, grid: Grid) -> Floats:
    """Absolute second differences at each cell; at an edge that of its neighbour."""
    if j in grid.periodic:
        return np.abs(step - np.roll(step, 1, axis=j))
    inner = np.abs(np.diff(step, axis=j))
    return np.concatenate([np.take(inner, [0], axis=j), inner, np.take(inner, [-1], axis=j)], axis=j)


def _window(grid: Grid, axes: tuple[int, ...]) -> tuple[int, ...]:
    return (*(3 if j in axes else 1 for j in range(len(grid.cells))), 1)


def _modes(grid: Grid) -> list[str]:
    return [*("wrap" if j in grid.periodic else "nearest" for j in range(len(grid.cells))), "nearest"]


def _spread(e: Floats, grid: Grid, axes: tuple[int, ...]) -> tuple[Floats, Floats]:
    size, mode = _window(grid, axes), _modes(grid)
    return minimum_filter(e, size=size, mode=mode), maximum_filter(e, size=size, mode=mode)
