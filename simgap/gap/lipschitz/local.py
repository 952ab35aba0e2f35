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
from simgap.gap.bounds.closed_form import CellRanges
from simgap.gap.lipschitz.grid import (
    REACH,
    GridLipschitz,
    Roughness,
    Slab,
    moving_axes,
    roughness,
    slabs,
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

    def _slabs(self) -> Iterator[Slab]:
        return slabs(self.grid, self.target.shape[1], REACH)

    def along(self, beside: OffGrid, fit: FitSlopes | None = None) -> tuple[Floats, Floats]:
        """Largest moves of t - q.p from samples beside the grid: along their surface, across it; (E, M) each.

        Along the surface they stand for half a cell on either side, by the slopes of the grid and by their own. What
        the residual does across it, between the centre of their cell and themselves, they show; the second number is
        what the slopes there allow.
        """
        bend, count = self._bend(fit), (len(beside.cells), self.target.shape[1])
        rows = {j: np.empty(count) for j in self.axes}
        for slab in self._slabs():
            of_slab = _Read(slab, self, fit)
            last = slab.first + of_slab.size
            here = np.flatnonzero((beside.cells >= slab.first) & (beside.cells < last))
            for some in slab.inputs if len(here) else ():
                for j, part in of_slab.parts(some):
                    rows[j][here, some] = part.reshape(of_slab.size, -1)[beside.cells[here] - slab.first]
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
        for slab in self._slabs():
            of_slab, own = _Read(slab, self, fit), _rows(slab, self.target)
            for some in slab.inputs:
                own[..., some] = sum(part for _, part in of_slab.parts(some)) + bend
                if any_rough:
                    marks = of_slab.marks(rough, some)
                    marked += int(marks.sum())
                    usual = max(usual, float(own[..., some][~marks].max(initial=0.0)))
            pad.put(slab.first, own.reshape(-1, own.shape[-1]))
        if any_rough:
            self._raise(pad, fit, rough, usual)
        return pad, marked / self.target.size

    def _raise(self, pad: Kept, fit: FitSlopes | None, rough: list[Roughness], usual: float) -> None:
        """Where the grid does not resolve t or e, at least to what the neighbours have."""
        bend = self._bend(fit)
        for slab in self._slabs():
            of_slab, own = _Read(slab, self, fit), _rows(slab, self.target)
            rows = own.reshape(-1, self.target.shape[1])
            rows[:] = pad[slab.first : slab.first + len(rows)]
            for some in slab.inputs:
                where = of_slab.marks(rough, some)
                if where.any():
                    straight, flat = of_slab.risen(some)
                    least = np.minimum(straight[where] + 5.0 * bend, flat[where] + bend) + usual
                    own[..., some][where] = np.maximum(own[..., some][where], least)
            pad.put(slab.first, rows)


def _rows(slab: Slab, target: Values) -> Floats:
    """An array for what belongs to a slab's own cells, for all inputs."""
    shape = [*slab.grid.cells, target.shape[1]]
    shape[slab.axis] = slab.inner.stop - slab.inner.start
    return np.empty(shape)


class _Read:
    """A target and its fit on one slab."""

    def __init__(self, slab: Slab, padding: LocalPadding, fit: FitSlopes | None) -> None:
        self.slab, self.padding, self.fit = slab, padding, fit
        self.field = slab.read(padding.target)
        self.size = _rows(slab, padding.target).size // padding.target.shape[1]

    @cached_property
    def residual(self) -> Floats:
        return self.field if self.fit is None else self.field - self.slab.read(self.fit.values)

    @cached_property
    def slopes(self) -> dict[int, Floats]:
        axes = self.padding.axes if self.fit is not None else ()
        return {j: self.slab.read(self.fit.slope(j)) for j in axes if self.fit is not None}

    def parts(self, some: slice) -> Iterator[tuple[int, Floats]]:
        """Share of each axis in the padding of the slab's own cells, for some inputs."""
        grid, axes = self.slab.grid, self.padding.axes
        for j in axes:
            expected = self.slopes[j][..., some] * 2.0 * self.padding.grid.h[j] if j in self.slopes else None
            step = steps(self.field[..., some], j, grid)
            beside = to_cells(step, j, grid, expected) + turns(step, j, grid, axes)
            yield j, 0.5 * self.slab.own(widest(beside, grid, axes))

    def marks(self, rough: list[Roughness], some: slice) -> Bools:
        """Rough cells of the target and of the residual."""
        fields = (self.field, self.residual)
        found = [own.marks(e[..., some], self.slab.grid) for own, e in zip(rough, fields, strict=False) if own.any]
        return self.slab.own(np.logical_or.reduce(found))

    def risen(self, some: slice) -> tuple[Floats, Floats]:
        """Excess of the largest neighbour over a cell: of the residual; of t, with what q.p rises in the cell."""
        grid, axes = self.slab.grid, self.padding.axes
        fields = (e[..., some] for e in (self.residual, self.field))
        left, field = (self.slab.own(widest(e, grid, axes) - e) for e in fields)
        own = np.zeros_like(field)
        for j, slope in self.slopes.items():
            own += self.slab.own(np.abs(slope[..., some]) * self.padding.grid.h[j])
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
    return GridLipschitz(constants, constants, ratio, constants, float(jump.mean()), None, largest, proven=True)
