"""The rows of a scenario program: the basis at every sample, never stored as one matrix.

A term that depends on the state alone is evaluated once for each state, one that depends on the input alone once for
each input; NumPy's broadcasting makes the product of them, for some states at a time. So a pass over a million samples
costs a few milliseconds, and a hundred million take no more memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.basis import Basis
from simgap.gap.sampling.values import Held, OfStates, Rows, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol

Term = Callable[..., Floats | float]


@dataclass(frozen=True, eq=False)
class Design:
    """Rows p(x_r, u_m) of all states (N, nx) times inputs (M, nu); row index r M + m."""

    basis: Basis
    x: Values
    u: Floats

    @staticmethod
    def of(basis: Basis, x: Floats, u: Floats) -> Design:
        """The design of states in memory."""
        return Design(basis, Held(x), u)

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return self.x.shape[0], len(self.u)

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.x.shape[0] * len(self.u)

    def rows(self, index: Rows) -> Floats:
        """Rows by index: (k,) -> (k, z)."""
        return self.basis.evaluate(self.x.take(index // len(self.u)), self.u[index % len(self.u)])

    def _evaluate(self, function: Term, x: Floats) -> Floats:
        """A term at states (n, nx), in the smallest shape that broadcasts to (n, M)."""
        value = np.asarray(function(*x.T[:, :, None], *self.u.T[:, None, :]), dtype=float)
        return value.reshape((1, 1)) if value.ndim == 0 else value

    @cached_property
    def _functions(self) -> list[Term]:
        return [self._compiled(e) for e in self.basis.exprs]

    @cached_property
    def _slope_functions(self) -> list[list[Term | None]]:
        return [[None if e == 0 else self._compiled(e) for e in row] for row in self.basis.gradients]

    def _compiled(self, expr: sp.Expr) -> Term:
        symbols = [symbol(s) for s in (*self.basis.states, *self.basis.inputs)]
        function: Term = sp.lambdify(symbols, expr, modules="numpy", cse=True)
        return function

    def columns(self, x: Floats) -> list[Floats]:
        """Every term at states (n, nx), in shapes that broadcast to (n, M)."""
        return [self._evaluate(function, x) for function in self._functions]

    def product(self, q: Floats) -> Values:
        """q.p at every sample: (z,) -> (N, M)."""
        parts = [(v, f) for v, f in zip(q, self._functions, strict=True) if v != 0.0]
        return self._summed(parts)

    def slope(self, q: Floats, j: int) -> Values:
        """d q.p / d x_j at every sample: (z,) -> (N, M)."""
        parts = [(v, row[j]) for v, row in zip(q, self._slope_functions, strict=True)]
        return self._summed([(v, f) for v, f in parts if v != 0.0 and f is not None])

    def _summed(self, parts: Sequence[tuple[float, Term]]) -> Values:
        """Sum of broadcastable parts; those of one shape are added before they meet the others."""

        def summed(x: Floats) -> Floats:
            by_shape: dict[tuple[int, ...], Floats] = {}
            for v, function in parts:
                part = v * self._evaluate(function, x)
                by_shape[part.shape] = by_shape[part.shape] + part if part.shape in by_shape else part
            total = np.zeros((len(x), len(self.u)))
            for part in by_shape.values():
                total += part
            return total

        return OfStates(summed, self.x, len(self.u))

    def _blocks(self) -> Iterator[tuple[int, int]]:
        """As those of values of this shape."""
        return self._summed(()).blocks()

    @cached_property
    def mean(self) -> Floats:
        """(z,) mean row."""
        total = np.zeros(self.basis.size)
        for first, last in self._blocks():
            total += (
                (last - first) / self.shape[0] * np.array([c.mean() for c in self.columns(self.x.rows(first, last))])
            )
        return total

    @cached_property
    def _gram(self) -> Floats:
        """(z, z) mean of p p^T."""
        z = self.basis.size
        gram = np.zeros((z, z))
        for first, last in self._blocks():
            columns = self.columns(self.x.rows(first, last))
            for a, b in combinations_with_replacement(range(z), 2):
                gram[a, b] += (last - first) / self.shape[0] * (columns[a] * columns[b]).mean()
        return np.triu(gram) + np.triu(gram, 1).T

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

    def least_squares(self, target: Values) -> Floats:
        """(z,) coefficients of the least-squares fit of (N, M) values; refined once against rounding."""
        w, q = self.whitening, np.zeros(self.basis.size)
        for _ in range(2):
            product, moment = self.product(q), np.zeros(len(q))
            for first, last in target.blocks():
                rest = target.rows(first, last) - product.rows(first, last)
                columns = self.columns(self.x.rows(first, last))
                moment += (last - first) / self.shape[0] * np.array([_moment(column, rest) for column in columns])
            q = q + w @ (w.T @ moment)
        return q


def _moment(column: Floats, rest: Floats) -> float:
    """Mean of column * rest without blowing the column up."""
    small = rest
    for axis in (0, 1):
        if column.shape[axis] == 1:
            small = small.mean(axis=axis, keepdims=True)
    return float((column * small).mean())
