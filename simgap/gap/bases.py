"""Bases p(x, u) of a gap bound q.p(x, u), each a list of symbolic terms; the registry `BASES` lists the kinds.

A basis keeps the texts of its terms, so that a saved bound can be read by a person and built again. Everything else
(values, gradients, ranges of the first two derivatives over the domain) is derived from the expressions, never by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import sympy as sp

from simgap.errors import UserError
from simgap.gap.enclosures import enclose
from simgap.geometry import Box, Floats
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
        corners = [*zip(domain.lo, domain.hi, strict=True), *zip(inputs.min(0), inputs.max(0), strict=True)]
        names = (*self.states, *self.inputs)
        box = {symbol(s): (float(lo), float(hi)) for s, (lo, hi) in zip(names, corners, strict=True)}
        values = [enclose(e, box) for e in self.exprs]
        slopes = [[enclose(g, box) for g in row] for row in self.gradients]
        return BasisRanges(
            value=np.array([v.magnitude for v in values]),
            gradient=np.array([[g.pair for g in row] for row in slopes]),
            hessian=np.array([[[enclose(e, box).magnitude for e in r] for r in rows] for rows in self.hessians]),
            value_rounding=np.array([v.error for v in values]),
            gradient_rounding=np.array([[g.error for g in row] for row in slopes]),
        )


def _stack(columns: Sequence[Floats | float], n: int) -> Floats:
    out = np.empty((len(columns), n))
    for k, column in enumerate(columns):
        out[k] = column
    return out.T


def expressions(states: Sequence[str], inputs: Sequence[str], domain: Box, *, terms: Sequence[str] = ()) -> Basis:
    """The terms as written."""
    return Basis(tuple(str(t) for t in terms), tuple(states), tuple(inputs))


def monomials(states: Sequence[str], inputs: Sequence[str], domain: Box, *, degree: int = 2) -> Basis:
    """All monomials of the states and inputs up to a total degree, inputs to the first power."""
    if degree < 0:
        raise UserError(f"the degree must not be negative, not {degree}", key="gap.basis.degree")
    names = (*states, *inputs)
    top = [degree] * len(states) + [1] * len(inputs)
    powers = [p for p in product(*(range(t + 1) for t in top)) if sum(p) <= degree]
    powers.sort(key=lambda p: (-sum(p), [-k for k in p]))
    return Basis(tuple(_monomial(names, p) for p in powers), tuple(states), tuple(inputs))


def _monomial(names: Sequence[str], powers: Sequence[int]) -> str:
    factors = [name if k == 1 else f"{name}^{k}" for name, k in zip(names, powers, strict=True) if k]
    return "*".join(factors) or "1"


def trigonometric(states: Sequence[str], inputs: Sequence[str], domain: Box, *, harmonics: int = 1) -> Basis:
    """sin and cos of `k omega_j x_j`, k = 1..harmonics, the inputs and 1; omega_j = pi / width of X along axis j.

    The period is twice the width, so that a term need not return to its first value across X.
    """
    if harmonics < 1:
        raise UserError(f"at least one harmonic is needed, not {harmonics}", key="gap.basis.harmonics")
    terms = []
    for name, width in zip(states, domain.hi - domain.lo, strict=True):
        for k in range(1, harmonics + 1):
            terms += [f"sin({k * np.pi / width:.15g}*{name})", f"cos({k * np.pi / width:.15g}*{name})"]
    return Basis((*terms, *inputs, "1"), tuple(states), tuple(inputs))


BASES: Mapping[str, Callable[..., Basis]] = {
    "expressions": expressions,
    "monomials": monomials,
    "trigonometric": trigonometric,
}
"""Symbolic bases by name. `blocks` is the one basis that is not symbolic, see `blocks.py`."""


def make_basis(kind: str, states: Sequence[str], inputs: Sequence[str], domain: Box, **options: object) -> Basis:
    """A basis of the registry; `terms`, `degree`, `harmonics` are its options.

    Raises:
        UserError: for an unknown kind, naming the known ones.
    """
    if kind not in BASES:
        known = ", ".join([*BASES, "blocks"])
        raise UserError(f"there is no basis '{kind}'", key="gap.basis", remedy=f"Known bases: {known}.")
    return BASES[kind](states, inputs, domain, **options)
