"""The rows of a scenario program: the basis at every sample, never stored as one matrix.

A term that depends on the state alone is kept once for each state, one that depends on the input alone once for each
input; NumPy's broadcasting makes the (N, M) product of them. So a pass over a million samples costs a few milliseconds
and megabytes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from simgap.gap.bases import Basis
from simgap.geometry import Floats
from simgap.model.symbolic import symbol

_KEEP = 40_000_000  # numbers; columns beyond that are evaluated again for each pass


@dataclass(frozen=True, eq=False)
class Design:
    """Rows p(x_r, u_m) of all states (N, nx) times inputs (M, nu); row index r M + m."""

    basis: Basis
    x: Floats
    u: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return len(self.x), len(self.u)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.x) * len(self.u)

    def rows(self, index: NDArray[np.int64]) -> Floats:
        """Rows by index: (k,) -> (k, z)."""
        return self.basis.evaluate(self.x[index // len(self.u)], self.u[index % len(self.u)])

    def _evaluate(self, function: Callable[..., Floats | float]) -> Floats:
        """A term in the smallest shape that broadcasts to (N, M)."""
        value = np.asarray(function(*self.x.T[:, :, None], *self.u.T[:, None, :]), dtype=float)
        return value.reshape((1, 1)) if value.ndim == 0 else value

    @cached_property
    def _functions(self) -> list[Callable[..., Floats | float]]:
        return [self._compiled(e) for e in self.basis.exprs]

    @cached_property
    def _slope_functions(self) -> list[list[Callable[..., Floats | float] | None]]:
        return [[None if e == 0 else self._compiled(e) for e in row] for row in self.basis.gradients]

    def _compiled(self, expr: sp.Expr) -> Callable[..., Floats | float]:
        symbols = [symbol(s) for s in (*self.basis.states, *self.basis.inputs)]
        function: Callable[..., Floats | float] = sp.lambdify(symbols, expr, modules="numpy", cse=True)
        return function

    @cached_property
    def _kept(self) -> list[Floats] | None:
        kept: list[Floats] = []
        for function in self._functions:
            kept.append(self._evaluate(function))
            if sum(c.size for c in kept) > _KEEP:
                return None
        return kept

    def column(self, k: int) -> Floats:
        """Term k at every sample, in a shape that broadcasts to (N, M)."""
        return self._kept[k] if self._kept is not None else self._evaluate(self._functions[k])

    def product(self, q: Floats) -> Floats:
        """q.p at every sample: (z,) -> (N, M)."""
        return self._summed([v * self.column(k) for k, v in enumerate(q) if v != 0.0])

    def slope(self, q: Floats, j: int) -> Floats:
        """d q.p / d x_j at every sample: (z,) -> (N, M)."""
        parts = [(v, row[j]) for v, row in zip(q, self._slope_functions, strict=True)]
        return self._summed([v * self._evaluate(f) for v, f in parts if v != 0.0 and f is not None])

    def _summed(self, parts: list[Floats]) -> Floats:
        """Sum of broadcastable parts; those of one shape are added before they meet the others."""
        by_shape: dict[tuple[int, ...], Floats] = {}
        for part in parts:
            by_shape[part.shape] = by_shape[part.shape] + part if part.shape in by_shape else part
        total = np.zeros(self.shape)
        for part in by_shape.values():
            total += part
        return total

    @cached_property
    def mean(self) -> Floats:
        """(z,) mean row."""
        return np.array([self.column(k).mean() for k in range(self.basis.size)])

    @cached_property
    def _gram(self) -> Floats:
        """(z, z) mean of p p^T."""
        z = self.basis.size
        gram = np.empty((z, z))
        for a in range(z):
            column = self.column(a)
            for b in range(a, z):
                gram[a, b] = gram[b, a] = (column * self.column(b)).mean()
        return gram

    @cached_property
    def whitening(self) -> Floats:
        """(z, k) map from coordinates y to coefficients q = W y in which the mean of (q.p)^2 is |y|^2.

        Directions in which the samples do not tell the terms apart are left out (their coefficient is 0).
        """
        scale = np.sqrt(np.diag(self._gram))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self._gram / np.outer(scale, scale))
        kept = values > 1e-12 * values.max()
        return (vectors[:, kept] / np.sqrt(values[kept])) / scale[:, None]

    def least_squares(self, target: Floats) -> Floats:
        """(z,) coefficients of the least-squares fit of (N, M) values; refined once against rounding."""
        w, q = self.whitening, np.zeros(self.basis.size)
        for _ in range(2):
            rest = target - self.product(q)
            moment = np.array([self._moment(self.column(k), rest) for k in range(self.basis.size)])
            q = q + w @ (w.T @ moment)
        return q

    def _moment(self, column: Floats, rest: Floats) -> float:
        """Mean of column * rest without blowing the column up."""
        small = rest
        for axis in (0, 1):
            if column.shape[axis] == 1:
                small = small.mean(axis=axis, keepdims=True)
        return float((column * small).mean())
