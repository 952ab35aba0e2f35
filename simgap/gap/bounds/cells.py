"""Gap function that is constant on each block of X, for each input.

On a border shared by blocks all of them apply, so a bound over a box is the extreme over the cells it touches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.function import (
    GapDomain,
    GapFunction,
    GapSuprema,
    Kernel,
    Tier,
    input_index,
    require,
    require_finite,
    require_sides,
    sides_by_state,
    sides_from,
)
from simgap.geometry import mesh
from simgap.late import njit
from simgap.model.compile import cached_kernel

_SLACK = 1.0 + 2.0**-48  # outward rounding of the few operations of a bound


@dataclass(frozen=True, eq=False)
class CellGap(GapFunction):
    """Tables over a tensor grid of cells.

    Attributes:
        edges: per axis, cell borders (k_j + 1,), the first and last are those of X.
        lower, upper: (k_1 * ... * k_nx, M, nx), row-major cells.
    """

    edges: tuple[Floats, ...]
    lower: Floats
    upper: Floats

    def _box_bounds(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        lo, hi = np.empty(xlo.shape), np.empty(xhi.shape)
        rows = tuple(np.ascontiguousarray(a, dtype=np.float64) for a in (xlo, xhi, u))
        _over_rows(*rows, lo, hi, *self._tables())
        return lo, hi

    def sup(self) -> dict[str, GapSuprema]:
        """Suprema over all cells and inputs; on a face that cells share, the hull of their bounds may be wider."""
        size = np.maximum(np.abs(self.lower), np.abs(self.upper)).max(axis=(0, 1)) * _SLACK
        width = (self.upper - self.lower).max(axis=(0, 1)) * _SLACK
        return {s: GapSuprema(float(size[i]), float(width[i])) for i, s in enumerate(self.domain.states)}

    def raised(self, below: Floats, above: Floats) -> CellGap:
        """lo - below, hi + above; both (nx,)."""
        return replace(self, lower=self.lower - below, upper=self.upper + above)

    def raised_within(self, where: Mapping[str, tuple[float, float]], by: Floats) -> CellGap:
        """Moved outward by more, (nx,), in the cells that a box touches; states that are not named may be anything."""
        axes = []
        for name, edges in zip(self.domain.states, self.edges, strict=True):
            lo, hi = where.get(name, (-np.inf, np.inf))
            margin = 1e-9 * (edges[-1] - edges[0])  # a border is of both cells, as in `_touched`
            axes.append((edges[:-1] <= hi + margin) & (edges[1:] >= lo - margin))
        more = np.where(np.all(mesh(*axes), axis=1, keepdims=True)[..., None], by, 0.0)
        return replace(self, lower=self.lower - more, upper=self.upper + more)

    def _kernel(self) -> Kernel:
        """See `GapFunction._kernel`; loops over the cells that the box touches."""
        inputs, limit_lo, limit_hi, edges, counts, lower, upper = self._tables()

        @cached_kernel
        def bounds_over_box(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
            _over_box(xlo, xhi, u, lo, hi, inputs, limit_lo, limit_hi, edges, counts, lower, upper)

        return bounds_over_box

    def _tables(self) -> tuple[Any, ...]:
        counts = np.array([len(e) - 1 for e in self.edges], dtype=np.int64)
        return self.domain.input_set, *self.domain.limits(), np.concatenate(self.edges), counts, self.lower, self.upper

    def _content(self) -> dict[str, Any]:
        names = self.domain.states
        return {
            "kind": "cells",
            "meaning": "lower <= simulator - nominal <= upper in each cell",
            "edges": {s: e.tolist() for s, e in zip(names, self.edges, strict=True)},
            "gap": sides_by_state(names, self.lower, self.upper),
        }

    @classmethod
    def from_content(cls, data: Mapping[str, Any], domain: GapDomain, tiers: tuple[Tier, ...]) -> CellGap:
        """The inverse of `_content`."""
        edges = tuple(np.array(data["edges"][s]) for s in domain.states)
        return cls(domain, tiers, edges, *sides_from(data["gap"], domain.states))

    def check(self) -> None:
        """See `GapFunction.check`."""
        box, nx, m = self.domain.box, len(self.domain.states), len(self.domain.input_set)
        for j, edges in enumerate(self.edges):
            require_finite("a row of edges", edges, (max(2, edges.size),))
            require((np.diff(edges) > 0).all(), "its cells do not follow each other")
            require(edges[0] == box.lo[j] and edges[-1] == box.hi[j], "its cells do not cover X")
        cells = int(np.prod([len(edges) - 1 for edges in self.edges]))
        require_sides(self.lower, self.upper, (cells, m, nx))


@njit(error_model="numpy", cache=True)
def _over_rows(xlo, xhi, u, lo, hi, inputs, llo, lhi, edges, counts, lower, upper):  # type: ignore[no-untyped-def]
    for n in range(len(xlo)):
        _over_box(xlo[n], xhi[n], u[n], lo[n], hi[n], inputs, llo, lhi, edges, counts, lower, upper)


@njit(error_model="numpy", cache=True)
def _over_box(xlo, xhi, u, lo, hi, inputs, llo, lhi, edges, counts, lower, upper):  # type: ignore[no-untyped-def]
    nx, row = len(counts), input_index(inputs, u)
    cells, start = 1, 0
    inside = row >= 0
    for j in range(nx):
        inside = inside and xlo[j] >= llo[j] and xhi[j] <= lhi[j]
        a, b = _touched(edges, start, counts[j], xlo[j], xhi[j])
        cells *= b - a + 1
        start += counts[j] + 1
    for i in range(nx):
        lo[i] = np.inf if inside else -np.inf
        hi[i] = -np.inf if inside else np.inf
    if inside:
        for n in range(cells):
            _widen_by_cell(n, xlo, xhi, row, lo, hi, edges, counts, lower, upper)


@njit(error_model="numpy", cache=True)
def _touched(edges, start, count, a, b):  # type: ignore[no-untyped-def]
    """First and last cell of one axis that [a, b] touches, borders included with a margin of 1e-9 of the axis."""
    axis = edges[start : start + count + 1]
    margin = 1e-9 * (axis[count] - axis[0])
    first = np.searchsorted(axis, a - margin, side="left") - 1
    last = np.searchsorted(axis, b + margin, side="right") - 1
    return min(max(first, 0), count - 1), min(max(last, 0), count - 1)


@njit(error_model="numpy", cache=True)
def _widen_by_cell(n, xlo, xhi, row, lo, hi, edges, counts, lower, upper):  # type: ignore[no-untyped-def]
    """Widen lo, hi by the bound over the n-th touched cell; the last axis runs fastest."""
    nx, flat, stride, end = len(counts), 0, 1, len(edges)
    for j in range(nx - 1, -1, -1):
        end -= counts[j] + 1
        a, b = _touched(edges, end, counts[j], xlo[j], xhi[j])
        flat += stride * (a + n % (b - a + 1))
        stride *= counts[j]
        n //= b - a + 1
    for i in range(nx):
        low, high = lower[flat, row, i], upper[flat, row, i]
        slack = 2.0**-48 * (abs(low) + abs(high)) + 1e-300
        lo[i] = min(lo[i], low - slack)
        hi[i] = max(hi[i], high + slack)
