"""How far the residual `e = t - q.p` of a fit may exceed its sample in a cell, for a gap known in closed form.

t is the gap or its negative. With its slope over the cell in [a, b], the slope s of q.p at the centre and H >= |its
second derivatives|, the mean value theorem for t and Taylor's for q.p give

    e(x) - e(centre) <= sum_j max(|a_j - s_j|, |b_j - s_j|) h_j + 1/2 sum_jk H_jk h_j h_k,

and from the range of t itself, which is what is left across a jump,

    e(x) - e(centre) <= sup t - t(centre) + sum_j |s_j| h_j + 1/2 sum_jk H_jk h_j h_k.

The smaller one is a bound, as `local.LocalPadding` is an estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.closed_form import CellRanges
from simgap.gap.lipschitz.local import Fit
from simgap.gap.lipschitz.result import GridLipschitz
from simgap.gap.sampling.values import Held, Values
from simgap.gap.thresholds import GATE

_OUTWARD = 1.0 + 2.0**-40  # the few operations of a padding


@dataclass(frozen=True, eq=False)
class EnclosedPadding:
    """Paddings of one target t (N, M): the gap in `ranges` (`upper`), or its negative. They are held in memory."""

    target: Values
    ranges: CellRanges
    upper: bool

    @property
    def axes(self) -> tuple[int, ...]:
        """All of them."""
        return tuple(range(len(self.ranges.reach)))

    def of_target(self) -> tuple[Values, float]:
        """Padding of t itself (q = 0): (N, M), and 0, the share of cells whose padding is no bound."""
        none = Held(np.zeros(self.target.shape))
        return self.of_residual(Fit(none, lambda j: none, np.zeros((0, 0))))

    def of_residual(self, fit: Fit) -> tuple[Values, float]:
        """Padding of t - q.p: (N, M), and 0."""
        known, r, curvature, target = self.ranges, self.ranges.reach, fit.curvature, self.target.whole()
        sign, top, centre = (1.0, known.hi, known.centre_hi) if self.upper else (-1.0, -known.lo, -known.centre_lo)
        bend = 0.5 * float(r @ curvature @ r) if curvature.size else 0.0
        steep, flat = centre - target, top - target
        for j in self.axes:
            own = fit.slope(j).whole()
            a, b = sign * known.slope_lo[..., j], sign * known.slope_hi[..., j]
            steep = steep + np.maximum(np.abs(a - own), np.abs(b - own)) * r[j]
            flat = flat + np.abs(own) * r[j]
        pad = np.maximum(np.fmin(steep, flat) + bend, 0.0) * _OUTWARD
        spread = 2.0**-50 * (np.abs(target) + np.abs(fit.values.whole()))
        return Held(pad + 2.0 * known.rounding + spread), 0.0


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
