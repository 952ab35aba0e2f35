"""Lipschitz estimates from the grid that is there: slopes between neighbours, and whether the grid resolves them.

Along axis j with spacing s = 2 h, a sample's slope is the larger of the differences to its two neighbours, over s; its
change of slope is the second difference over s, and half the mixed ones for the way to the cell's corners. The estimate
of a constant is the largest slope plus change of slope. It is an *estimate*: samples cannot prove a bound between them.
The resolution ratio L(s) / L(2 s) tells whether the grid sees the steepest part: above `GATE` it does not, and the
constant must not be used, unless the steep cells are few and are covered by the jump seen there (`rough_cells`), as
with Coulomb friction at rest.

No number of one input depends on those of another but through largest values, so inputs are taken some at a time: what
is held beside the values themselves does not grow with their number, and the result is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from simgap.errors import UserError
from simgap.gap.lipschitz.result import GridLipschitz, Layer
from simgap.gap.thresholds import CROWDED, GATE, SPLIT_GATE, STEEP_SHARE
from simgap.geometry import Floats, Grid

Mask = NDArray[np.bool_]
PIECE = 2**19
"""Samples that are looked at together, if one input has no more."""


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
        s = 2.0 * grid.h[j]
        for own in pieces(e):
            step = steps(e[own], j, grid)
            first = to_cells(step, j, grid)
            local = (first + turns(step, j, grid, axes)) / s
            constants[j], slopes[j] = max(constants[j], local.max()), max(slopes[j], first.max() / s)
            smooth[j] = max(smooth[j], local[~rough[own]].max(initial=0.0))
        ratio[j] = _resolution(e, j, grid, floor)
    share, box, jump, at = float(rough.mean()), None, 0.0, None
    if rough.any():
        largest = np.zeros(grid.size)
        for own in pieces(e):
            spread = np.where(rough[own], _spread(e[own], grid, axes), 0.0)
            largest = np.maximum(largest, spread.reshape(grid.size, -1).max(axis=1))
        jump, at = float(largest.max()), grid.centres()[int(np.argmax(largest))]
        places = grid.centres()[rough.reshape(grid.size, -1).any(axis=1)]
        box = np.stack([places.min(axis=0) - grid.h, places.max(axis=0) + grid.h])
    layers = tuple(o for j in axes if (o := _layer(rough, j, grid)) is not None)
    return GridLipschitz(constants, slopes, ratio, smooth, share, box, jump, layers=layers, at=at)


def _layer(rough: Mask, j: int, grid: Grid) -> Layer | None:
    """Where rough cells crowd along axis j: neighbouring layers that have clearly more of them than the others."""
    own = rough.mean(axis=tuple(k for k in range(rough.ndim) if k != j))
    if own.max() <= CROWDED * own.min():
        return None
    crowded = np.flatnonzero(own > 0.5 * (own.min() + own.max()))
    first, last = int(crowded[0]), int(crowded[-1])
    if last - first + 1 > min(len(crowded), 0.5 * len(own)):
        return None
    ends = grid.axis(j)[[first, last]] + grid.h[j] * np.array([-1.0, 1.0])
    return Layer(j, float(ends[0]), float(ends[1]), float(own[crowded].mean()))


def _resolution(e: Floats, j: int, grid: Grid, floor: float) -> float:
    """L(s) / L(2 s), or L(2 s) / L(4 s) if larger: a jump on a sample is split in two and hides from the first."""
    known = [cells for cells in (1, 2, 4) if cells < grid.cells[j]]
    top = [max(np.abs(double_steps(e[own], j, grid, n)).max() for own in pieces(e)) / n for n in known]
    pairs = [(a, b) for a, b in pairwise(top) if a > floor]
    return max((float(a / b) if b > 0.0 else np.inf for a, b in pairs), default=1.0)


def rough_cells(e: Floats, grid: Grid, axes: tuple[int, ...], floor: float, split: bool = True) -> Mask:
    """Cells around differences that the grid does not resolve: (cells_1, ..., cells_nx, M), as `e`.

    Outside them every ratio of `_resolution` is <= GATE. Steep differences are taken out, steepest first, until the
    ratio of the rest passes; the cells on both sides and their neighbours are rough. With `split` then the same over
    two cells, for jumps on a sample: they are split in two and no steeper over one cell than over two. Differences up
    to `floor` never are.
    """
    rough = np.zeros(e.shape, dtype=bool)
    for j in axes:
        out = _steep(e, j, grid, 1, floor, GATE, None)
        if out.any():
            for own in pieces(e):
                rough[own] |= to_cells(out[own], j, grid) > 0
        if split and grid.cells[j] > 4:
            known = _contain(out, j, grid, 1)
            rough |= _middle(_steep(e, j, grid, 2, floor, SPLIT_GATE, known) & ~known, j, grid)
    if not rough.any():
        return rough
    for own in pieces(e):
        rough[own] = maximum_filter(rough[own].view(np.uint8), size=window(grid, axes), mode=modes(grid)) > 0
    return rough


def _steep(e: Floats, j: int, grid: Grid, cells: int, floor: float, gate: float, known: Mask | None) -> Mask:
    """Differences over `cells` cells without which those over twice as many are within `gate`; `known` ones are out."""
    shape = list(e.shape)
    shape[j] -= 0 if j in grid.periodic else cells
    out = np.zeros(shape, dtype=bool) if known is None else known.copy()
    while True:
        fine = broad = 0.0
        for own in pieces(e):
            step, wide = (np.abs(double_steps(e[own], j, grid, n)) for n in (cells, 2 * cells))
            fine = max(fine, step[~out[own]].max(initial=0.0))
            broad = max(broad, 0.5 * wide[~_contain(out[own], j, grid, cells)].max(initial=0.0))
        if fine <= max(gate * broad, floor):
            return out
        for own in pieces(e):
            step = np.abs(double_steps(e[own], j, grid, cells))
            out[own] |= step > max(gate * broad, STEEP_SHARE * fine, floor)


def pieces(e: NDArray[np.generic]) -> Iterator[tuple[EllipsisType, slice]]:
    """Indices of some inputs after the others, of values (cells_1, ..., cells_nx, M)."""
    inputs = e.shape[-1]
    together = max(1, PIECE * inputs // max(1, e.size))
    for first in range(0, inputs, together):
        yield ..., slice(first, first + together)


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


def steps(e: Floats, j: int, grid: Grid) -> Floats:
    """Differences of neighbours along j: (..., k, ..., M) -> (..., k - 1, ..., M); k, with the seam, if periodic."""
    if j in grid.periodic:
        return np.roll(e, -1, axis=j) - e
    return np.diff(e, axis=j)


def double_steps(e: Floats, j: int, grid: Grid, cells: int = 2) -> Floats:
    """Differences over `cells` cells along axis j: (..., k, ..., M) -> (..., k - cells, ..., M), or k if periodic."""
    if j in grid.periodic:
        return np.roll(e, -cells, axis=j) - e
    n = e.shape[j]
    return np.take(e, range(cells, n), axis=j) - np.take(e, range(n - cells), axis=j)


def _contain(out: Mask, j: int, grid: Grid, cells: int) -> Mask:
    """Differences over twice `cells` cells that contain one of `out`, which are over `cells` cells."""
    if j in grid.periodic:
        return np.logical_or.reduce([np.roll(out, -k, axis=j) for k in range(cells + 1)])
    n = out.shape[j] - cells
    return np.logical_or.reduce([np.take(out, range(k, n + k), axis=j) for k in range(cells + 1)])


def _middle(out: Mask, j: int, grid: Grid) -> Mask:
    """The cells in the middle of differences over two cells."""
    if j in grid.periodic:
        return np.roll(out, 1, axis=j)
    edge = np.zeros_like(np.take(out, [0], axis=j))
    return np.concatenate([edge, out, edge], axis=j)


def to_cells(step: Floats | Mask, j: int, grid: Grid, expected: Floats | None = None) -> Floats:
    """Larger absolute difference beside each cell, less its `expected`: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        ahead, behind = step, np.roll(step, 1, axis=j)
    else:
        first, last = np.take(step, [0], axis=j), np.take(step, [-1], axis=j)
        ahead, behind = np.concatenate([step, last], axis=j), np.concatenate([first, step], axis=j)
    if expected is None:
        return np.maximum(np.abs(ahead), np.abs(behind))
    return np.maximum(np.abs(ahead - expected), np.abs(behind - expected))


def bends(step: Floats, j: int, grid: Grid) -> Floats:
    """Absolute second differences at each cell, at an edge its neighbour's: `steps` -> (cells_1, ..., cells_nx, M)."""
    if j in grid.periodic:
        return np.abs(step - np.roll(step, 1, axis=j))
    inner = np.abs(np.diff(step, axis=j))
    return np.concatenate([np.take(inner, [0], axis=j), inner, np.take(inner, [-1], axis=j)], axis=j)


def turns(step: Floats, j: int, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Change of `steps` along j within a cell: along j, half a cell along the others; (cells_1, ..., cells_nx, M)."""
    total = bends(step, j, grid)
    for k in axes:
        if k != j:
            total += 0.5 * to_cells(to_cells(steps(step, k, grid), k, grid), j, grid)
    return total


def window(grid: Grid, axes: tuple[int, ...]) -> tuple[int, ...]:
    """Filter size that reaches the neighbours of a cell, diagonal ones included."""
    return (*(3 if j in axes else 1 for j in range(len(grid.cells))), 1)


def modes(grid: Grid) -> list[str]:
    """Filter border modes."""
    return [*("wrap" if j in grid.periodic else "nearest" for j in range(len(grid.cells))), "nearest"]


def _spread(e: Floats, grid: Grid, axes: tuple[int, ...]) -> Floats:
    """Largest less least value around each cell."""
    size, mode = window(grid, axes), modes(grid)
    return np.asarray(maximum_filter(e, size=size, mode=mode) - minimum_filter(e, size=size, mode=mode))
