"""The basis p(x, u) of a gap bound q.p(x, u): a list of symbolic terms, whichever of the `kinds` listed them.

A basis keeps the texts of its terms, so that a saved bound can be read by a person and built again. Everything else
(values, gradients, ranges of the first two derivatives over the domain) is derived from the expressions, never by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.enclosures import enclose
from simgap.geometry import Box
from simgap.late import sympy as sp
from simgap.model.expressions import parse
from simgap.model.symbolic import symbol


@dataclass(frozen=True, eq=False)
class BasisRanges:
    """Ranges of the z terms and their derivatives over X x U, and bounds of their rounding.

    Attributes:
        value: (z,) largest absolute value of a term.
        gradient: (z, nx, 2) range of d p / d x_j.
        hessian: (z, nx, nx) largest absolute second derivative.
        value_rounding, gradient_rounding: (z,), (z, nx) bounds of the floating-point error.
    """

    value: Floats
    gradient: Floats
    hessian: Floats
    value_rounding: Floats
    gradient_rounding: Floats


@dataclass(frozen=True)
class Basis:
    """Terms p_l(x, u) over named states and inputs; twice differentiable in x.

    Raises:
        UserError: for a term that cannot be parsed, twice the same term, or one that is not twice differentiable.
    """

    terms: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]

    def __post_init__(self) -> None:
        seen: dict[sp.Expr, str] = {}
        for text, expr in zip(self.terms, self.exprs, strict=True):
            if expr in seen:
                raise UserError(f"the terms '{seen[expr]}' and '{text}' are the same", key="gap.basis")
            seen[expr] = text
        if not self.terms:
            raise UserError("the basis has no terms", key="gap.basis", remedy="List at least the constant 1.")

    @cached_property
    def exprs(self) -> tuple[sp.Expr, ...]:
        """The terms as SymPy expressions."""
        names = (*self.states, *self.inputs)
        return tuple(parse(text, names) for text in self.terms)

    @cached_property
    def gradients(self) -> tuple[tuple[sp.Expr, ...], ...]:
        """d p_l / d x_j, [l][j]."""
        return tuple(tuple(sp.diff(e, symbol(s)) for s in self.states) for e in self.exprs)

    @cached_property
    def hessians(self) -> tuple[tuple[tuple[sp.Expr, ...], ...], ...]:
        """d^2 p_l / d x_j d x_k, [l][j][k]."""
        found = tuple(tuple(tuple(sp.diff(g, symbol(s)) for s in self.states) for g in row) for row in self.gradients)
        for text, rows in zip(self.terms, found, strict=True):
            if any(e.has(sp.DiracDelta, sp.Derivative, sp.Heaviside, sp.sign) for row in rows for e in row):
                raise UserError(
                    f"the term '{text}' is not twice differentiable in the states",
                    key="gap.basis",
                    remedy="Use a smooth term such as tanh(x/0.01), or the blocks basis.",
                )
        return found

    @property
    def size(self) -> int:
        """Number of terms z."""
        return len(self.terms)

    def evaluate(self, x: Floats, u: Floats) -> Floats:
        """p(x, u): (n, nx), (n, nu) -> (n, z)."""
        return _stack(self._values(*x.T, *u.T), len(x))

    def evaluate_gradient(self, x: Floats, u: Floats) -> Floats:
        """d p / d x: (n, nx), (n, nu) -> (n, z, nx)."""
        return _stack(self._slopes(*x.T, *u.T), len(x)).reshape(len(x), self.size, len(self.states))

    @cached_property
    def _values(self) -> Callable[..., list[Floats]]:
        return self._compiled(list(self.exprs))

    @cached_property
    def _slopes(self) -> Callable[..., list[Floats]]:
        return self._compiled([g for row in self.gradients for g in row])

    def _compiled(self, exprs: list[sp.Expr]) -> Callable[..., list[Floats]]:
        symbols = [symbol(s) for s in (*self.states, *self.inputs)]
        function: Callable[..., list[Floats]] = sp.lambdify(symbols, exprs, modules="numpy", cse=True)
        return function

    def ranges(self, domain: Box, inputs: Floats) -> BasisRanges:
        """Ranges over `domain` and the hull of the inputs (M, nu).

        Raises:
            UserError: where a term or one of its first two derivatives is not finite there.
        """
        second = self.hessians  # refuses a kink before its slopes are asked for
        corners = [*zip(domain.lo, domain.hi, strict=True), *zip(inputs.min(0), inputs.max(0), strict=True)]
        names = (*self.states, *self.inputs)
        box = {symbol(s): (float(lo), float(hi)) for s, (lo, hi) in zip(names, corners, strict=True)}
        values = [enclose(e, box) for e in self.exprs]
        slopes = [[enclose(g, box) for g in row] for row in self.gradients]
        return BasisRanges(
            value=np.array([v.magnitude for v in values]),
            gradient=np.array([[g.pair for g in row] for row in slopes]),
            hessian=np.array([[[enclose(e, box).magnitude for e in r] for r in rows] for rows in second]),
            value_rounding=np.array([v.error for v in values]),
            gradient_rounding=np.array([[g.error for g in row] for row in slopes]),
        )


def _stack(columns: Sequence[Floats | float], n: int) -> Floats:
    out = np.empty((len(columns), n))
    for k, column in enumerate(columns):
        out[k] = column
    return out.T
