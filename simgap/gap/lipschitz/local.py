"""Local padding: how far the residual `e = t - q.p` of a fit may exceed its sample inside a cell.

t, what a side of the bound has to cover, is known at the cell centres alone, so its slope is estimated there: the
differences to both neighbours, and the change of slope. The slope and curvature of q.p are known, and never estimated:

    pad_r = sum_j h_j max over the cell and its neighbours of ( |slope_j t - d_j q.p| + |change of slope_j t| )
            + 1/2 sum_jk H_jk h_j h_k,                                      H_jk >= |d_jk q.p| on X x U.

Where the grid does not resolve t or e (a jump), t is taken to stay within the values of the neighbouring samples,
and the padding is at least that.

Where the gap is known in closed form the padding is a bound and no estimate. With the slope of t over the cell in
[a, b], and s that of q.p at the centre, the mean value theorem for t and Taylor's for q.p give

    e(x) - e(centre) <= sum_j max(|a_j - s_j|, |b_j - s_j|) h_j + 1/2 sum_jk H_jk h_j h_k,

and from the range of t itself, which is what is left across a jump,

    e(x) - e(centre) <= sup t - t(centre) + sum_j |s_j| h_j + 1/2 sum_jk H_jk h_j h_k.

The smaller one is taken (`EnclosedPadding`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.gap.bounds.enclosures import CellRanges
from simgap.gap.lipschitz.grid import (
    GridLipschitz,
    Roughness,
    moving_axes,
    on_cells,
    pieces,
    roughness,
    steps,
    to_cells,
    turns,
    widest,
)
from simgap.gap.sampling.borders import Borders, Directed
from simgap.gap.sampling.values import Kept, Room, Values, combined, in_memory, values
from simgap.gap.thresholds import GATE
from simgap.geometry import Grid


@dataclass(frozen=True, eq=False)
class OffGrid:
    """Samples beside the grid: their cells (E,), where they lie (E states), and the residual t - q.p there, (E, M)."""

    cells: Ints
    at: Borders
    residual: Floats

    @staticmethod
    def of(directed: Directed, grid: Grid, residual: Floats) -> OffGrid:
        """Samples beside this grid, with the residual there."""
        return OffGrid(grid.index(directed.x), directed.at, residual)

    def moved(self, j: int, h: float) -> Floats:
        """Largest move of the residual along axis j within h on its own sheet, by its own neighbours there: (E, M).

        A gap may be steep beside a surface (stick or slip) where it is flat in the middle of the cell.
        """
        before, after = self.at.neighbours(j).T
        back, on = (self._slope(a, b, j) for a, b in ((before, np.arange(len(before))), (np.arange(len(after)), after)))
        lone = ((before == np.arange(len(before))) | (after == np.arange(len(after))))[:, None]
        part = np.maximum(np.abs(back), np.abs(on)) + np.where(lone, 0.0, np.abs(on - back))
        return h * np.maximum(np.maximum(part[before], part), part[after])

    def _slope(self, a: Ints, b: Ints, j: int) -> Floats:
        away = (self.at.x[b, j] - self.at.x[a, j])[:, None]
        return (self.residual[b] - self.residual[a]) / np.where(away > 0.0, away, np.inf)


@dataclass(frozen=True, eq=False)
class FitSlopes:
    """q.p at the samples (N, M), its slopes there by axis, and H (nx, nx) >= its second derivatives anywhere."""

    values: Values
    slope: Callable[[int], Values]
    curvature: Floats


@dataclass(frozen=True, eq=False)
class LocalPadding:
    """Local paddings of one target t (N, M) on a grid; `floor` is the size of differences that are rounding alone.

    `room` is where paddings are kept.
    """

    target: Values
    grid: Grid
    free: tuple[int, ...]
    floor: float
    room: Room = in_memory

    @cached_property
    def axes(self) -> tuple[int, ...]:
        """Axes along which the gap may change."""
        return moving_axes(self.grid, self.free)

    @cached_property
    def _rough(self) -> Roughness:
        return roughness(self.target, self.grid, self.axes, self.floor)

    def _pieces(self, fit: FitSlopes | None) -> Iterator[_Piece]:
        return (_Piece(self, fit, some) for some in pieces(self.target.shape[1], self.grid))

    def along(self, beside: OffGrid, fit: FitSlopes | None = None) -> tuple[Floats, Floats]:
        """Largest moves of t - q.p from samples beside the grid: along their surface, across it; (E, M) each.

        Along the surface they stand for half a cell on either side, by the slopes of the grid and by their own. What
        the residual does across it, between the centre of their cell and themselves, they show; the second number is
        what the slopes there allow.
        """
        bend, count = self._bend(fit), (len(beside.cells), self.target.shape[1])
        rows = {j: np.empty(count) for j in self.axes}
        for piece in self._pieces(fit):
            for j, part in piece.parts():
                rows[j][:, piece.some] = part.reshape(self.grid.size, -1)[beside.cells]
        moved, held = np.zeros(count), np.zeros((1, 1))
        for j, own in rows.items():
            fixed = beside.at.fixed[:, [j]]
            moved = moved + np.where(fixed, 0.0, np.maximum(own, beside.moved(j, float(self.grid.h[j]))))
            held = held + np.where(fixed, own, 0.0)
        return moved + bend, held + bend

    def _bend(self, fit: FitSlopes | None) -> float:
        moving = np.array([h if j in self.axes else 0.0 for j, h in enumerate(self.grid.h)])
        return 0.5 * float(moving @ fit.curvature @ moving) if fit is not None and fit.curvature.size else 0.0

    def of(self, fit: FitSlopes | None = None) -> tuple[Values, float]:
        """Padding of t - q.p, of t itself without a fit: (N, M), and the share of rough cells."""
        bend, pad, marked, usual = self._bend(fit), self.room(self.target.shape), 0, 0.0
        rough = [self._rough]
        if fit is not None:  # t has the jumps on samples
            residual = combined(np.subtract, self.target, fit.values)
            rough.append(roughness(residual, self.grid, self.axes, self.floor, split=False))
        any_rough = any(own.any for own in rough)
        for piece in self._pieces(fit):
            own = sum((part for _, part in piece.parts()), np.zeros(())) + bend
            if any_rough:
                marks = piece.marks(rough)
                marked += int(marks.sum())
                usual = max(usual, float(own[~marks].max(initial=0.0)))
            pad.put_inputs(piece.some, own.reshape(self.grid.size, -1))
        if any_rough:
            self._raise(pad, fit, rough, usual)
        return pad, marked / self.target.size

    def _raise(self, pad: Kept, fit: FitSlopes | None, rough: list[Roughness], usual: float) -> None:
        """Where the grid does not resolve t or e, at least to what the neighbours have."""
        bend = self._bend(fit)
        for piece in self._pieces(fit):
            where = piece.marks(rough)
            if where.any():
                own, (straight, flat) = on_cells(pad, piece.some, self.grid), piece.risen()
                least = np.minimum(straight[where] + 5.0 * bend, flat[where] + bend) + usual
                own[where] = np.maximum(own[where], least)
                pad.put_inputs(piece.some, own.reshape(self.grid.size, -1))


class _Piece:
    """A target and its fit for `some` inputs, on all cells."""

    def __init__(self, padding: LocalPadding, fit: FitSlopes | None, some: slice) -> None:
        self.padding, self.fit, self.some = padding, fit, some
        self.field = on_cells(padding.target, some, padding.grid)

    @cached_property
    def residual(self) -> Floats:
        return self.field if self.fit is None else self.field - on_cells(self.fit.values, self.some, self.padding.grid)

    @cached_property
    def slopes(self) -> dict[int, Floats]:
        if self.fit is None:
            return {}
        return {j: on_cells(self.fit.slope(j), self.some, self.padding.grid) for j in self.padding.axes}

    def parts(self) -> Iterator[tuple[int, Floats]]:
        """Share of each axis in the padding of the cells."""
        grid, axes = self.padding.grid, self.padding.axes
        for j in axes:
            expected = self.slopes[j] * 2.0 * grid.h[j] if j in self.slopes else None
            step = steps(self.field, j, grid)
            yield j, 0.5 * widest(to_cells(step, j, grid, expected) + turns(step, j, grid, axes), grid, axes)

    def marks(self, rough: list[Roughness]) -> Bools:
        """Rough cells of the target and of the residual."""
        fields = (self.field, self.residual)
        found = [own.marks(e, self.padding.grid) for own, e in zip(rough, fields, strict=False) if own.any]
        return np.asarray(np.logical_or.reduce(found))

    def risen(self) -> tuple[Floats, Floats]:
        """Excess of the largest neighbour over a cell: of the residual; of t, with what q.p rises in the cell."""
        grid, axes = self.padding.grid, self.padding.axes
        left, field = (widest(e, grid, axes) - e for e in (self.residual, self.field))
        own = np.zeros_like(field)
        for j, slope in self.slopes.items():
            own += np.abs(slope) * grid.h[j]
        return left, field + own


_OUTWARD = 1.0 + 2.0**-40  # the few operations of a padding


@dataclass(frozen=True, eq=False)
class EnclosedPadding:
    """Paddings of one target t (N, M): the gap in `ranges` (`upper`), or its negative. They are held in memory."""

    target: Values
    ranges: CellRanges
    upper: bool

    def of(self, fit: FitSlopes | None = None) -> tuple[Values, float]:
        """Padding of t - q.p, of t itself without a fit: (N, M), and 0, the share of cells where it is no bound."""
        if fit is None:
            none = values(np.zeros(self.target.shape))
            fit = FitSlopes(none, lambda j: none, np.zeros((0, 0)))
        known, r, curvature, target = self.ranges, self.ranges.reach, fit.curvature, self.target.whole()
        sign, top, centre = (1.0, known.hi, known.centre_hi) if self.upper else (-1.0, -known.lo, -known.centre_lo)
        bend = 0.5 * float(r @ curvature @ r) if curvature.size else 0.0
        steep, flat = centre - target, top - target
        for j in range(len(r)):
            own = fit.slope(j).whole()
            a, b = sign * known.slope_lo[..., j], sign * known.slope_hi[..., j]
            steep = steep + np.maximum(np.abs(a - own), np.abs(b - own)) * r[j]
            flat = flat + np.abs(own) * r[j]
        pad = np.maximum(np.fmin(steep, flat) + bend, 0.0) * _OUTWARD
        spread = 2.0**-50 * (np.abs(target) + np.abs(fit.values.whole()))
        return values(pad + 2.0 * known.rounding + spread), 0.0


def enclosed_constants(known: CellRanges, h: Floats) -> GridLipschitz:
    """Proven constants per axis from the slopes on all cells, half-widths h (nx,), which may be used with h.

    A jump has none, and its axis counts as not resolved.
    """
    steepest = np.maximum(np.abs(known.slope_lo), np.abs(known.slope_hi))  # (N, M, nx)
    jump = np.asarray(~np.isfinite(steepest).all(axis=2))
    constants = np.where(jump[..., None], 0.0, steepest).max(axis=(0, 1)) * (known.reach / h) * _OUTWARD
    bounded = np.isfinite(steepest).all(axis=(0, 1))
    ratio = np.where(bounded, 1.0, 2.0 * GATE)
    largest = float((known.hi - known.lo)[jump].max(initial=0.0))
    return GridLipschitz(constants, ratio, float(jump.mean()), largest, proven=True)
