"""One side of a gap bound, `g(x, u) = q.p(x, u) + offset`, and its rigorous range over boxes.

Over the box with centre c and half-widths r, Taylor's theorem gives

    |g(x, u) - g(c, u)| <= sum_j |d_j g(c, u)| r_j + 1/2 sum_jk H_jk r_j r_k,      H_jk >= sup over X x U of |d_jk g|,

and `rounding` covers the floating-point evaluation of the right-hand side. For the small cells of an abstraction the
second sum is negligible, so the range is as good as exact. Valid for boxes inside the domain only; there are no bounds
outside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.bases import Basis, BasisRanges
from simgap.geometry import Box

MARGIN = 1e-9  # relative to the width of X: cell borders computed in floating point may stick out of X by this much


@dataclass(frozen=True, eq=False)
class Form:
    """`q.p(x, u) + offset` on a domain; `ranges` belong to the basis on that domain widened by MARGIN."""

    basis: Basis
    ranges: BasisRanges
    domain: Box
    coefficients: Floats
    offset: float = 0.0

    def with_offset(self, offset: float) -> Form:
        """The same form with another constant."""
        return replace(self, offset=float(offset))

    @cached_property
    def gradient_bound(self) -> Floats:
        """(nx,) sup over X x U of |d_j q.p|: the analytic Lipschitz constants L2 per axis (paper, Assumption 1)."""
        ends = self.coefficients[:, None, None] * self.ranges.gradient
        lo, hi = ends.min(axis=2).sum(axis=0), ends.max(axis=2).sum(axis=0)
        return np.maximum(np.abs(lo), np.abs(hi)) * (1.0 + 1e-12)

    @cached_property
    def hessian_bound(self) -> Floats:
        """(nx, nx) bound of |d_jk q.p| over X x U."""
        return np.tensordot(np.abs(self.coefficients), self.ranges.hessian, axes=1) * (1.0 + 1e-12)

    @cached_property
    def rounding(self) -> float:
        """Bound of the floating-point error of values and of ranges over boxes."""
        q, z = np.abs(self.coefficients), len(self.coefficients)
        ranges, widths = self.ranges, self.domain.hi - self.domain.lo
        slack = (z + 6) * 2.0**-52
        value = q @ ranges.value_rounding + slack * (q @ ranges.value + abs(self.offset))
        steepest = np.abs(ranges.gradient).max(axis=2)
        slope = q @ ranges.gradient_rounding + slack * (q @ steepest)
        curvature = widths @ self.hessian_bound @ widths * 16.0 * 2.0**-52
        # the box centre is rounded: half a unit in the last place of x, times the slope
        centre = (q @ steepest) @ np.maximum(np.abs(self.domain.lo), np.abs(self.domain.hi)) * 4.0 * 2.0**-52
        return float(2.0 * (value + slope @ widths + curvature + centre) + 1e-300)

    def values(self, x: Floats, u: Floats) -> Floats:
        """g(x, u): (n, nx), (n, nu) -> (n,), off by at most `rounding`."""
        return self.basis.evaluate(x, u) @ self.coefficients + self.offset

    def box_range(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Lower and upper bound of g over each box: (n, nx), (n, nx), (n, nu) -> (n,), (n,)."""
        centre = 0.5 * (xlo + xhi)
        r = 0.5 * (xhi - xlo) * (1.0 + 2.0**-50)
        middle = self.values(centre, u)
        slopes = np.einsum("nlj,l->nj", self.basis.evaluate_gradient(centre, u), self.coefficients)
        spread = (np.abs(slopes) * r).sum(axis=1) + 0.5 * np.einsum("nj,jk,nk->n", r, self.hessian_bound, r)
        return middle - spread - self.rounding, middle + spread + self.rounding


def widened(domain: Box) -> Box:
    """The domain with the margin on which `Form.ranges` are taken."""
    margin = MARGIN * (domain.hi - domain.lo)
    return Box(domain.lo - margin, domain.hi + margin)


def make_form(basis: Basis, domain: Box, inputs: Floats, coefficients: Floats, offset: float = 0.0) -> Form:
    """A form on `domain` for the input set (M, nu)."""
    return Form(basis, basis.ranges(widened(domain), inputs), domain, np.asarray(coefficients, float), float(offset))


def negated(form: Form) -> Form:
    """-g."""
    return replace(form, coefficients=-form.coefficients, offset=-form.offset)


def difference(a: Form, b: Form) -> Form:
    """a - b, of two forms over the same basis and domain."""
    return replace(a, coefficients=a.coefficients - b.coefficients, offset=a.offset - b.offset)
