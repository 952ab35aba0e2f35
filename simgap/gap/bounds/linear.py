"""Gap function whose sides are linear in a basis p, `lo_i = q.p(x, u) + c`, `hi_i = r.p(x, u) + e`, and its forms.

A basis keeps the texts of its terms, so that a person can read a saved bound and it can be built again. Values,
gradients and the ranges of the first two derivatives are derived from the expressions. Over the box with centre c and
half-widths r, Taylor's theorem gives

    |g(x, u) - g(c, u)| <= sum_j |d_j g(c, u)| r_j + 1/2 sum_jk H_jk r_j r_k,      H_jk >= sup over X x U of |d_jk g|,

and `rounding` covers the floating-point evaluation of the right-hand side. For the small cells of an abstraction the
second sum is negligible, so the range is as good as exact. It is valid for boxes inside the domain only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.enclosures import enclose
from simgap.gap.bounds.function import (
    MARGIN,
    GapDomain,
    GapFunction,
    GapSuprema,
    Kernel,
    Tier,
    require,
    require_finite,
    require_sides,
)
from simgap.geometry import Box, Grid, mesh
from simgap.late import sympy as sp
from simgap.model.compile import cached_kernel, compile_kernel
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
        texts: dict[sp.Expr, str] = {}
        for text, expr in zip(self.terms, self.exprs, strict=True):
            if expr in texts:
                raise UserError(f"the terms '{texts[expr]}' and '{text}' are the same", key="gap.basis")
            texts[expr] = text
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
        return self.compiled(list(self.exprs))

    @cached_property
    def _slopes(self) -> Callable[..., list[Floats]]:
        return self.compiled([g for row in self.gradients for g in row])

    def compiled(self, expr: Any) -> Callable[..., Any]:
        """An expression or a list of them as a function of all states and inputs, which broadcast."""
        symbols = [symbol(s) for s in (*self.states, *self.inputs)]
        function: Callable[..., Any] = sp.lambdify(symbols, expr, modules="numpy", cse=True)
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

    def slopes(self, x: Floats, u: Floats) -> Floats:
        """d g / d x: (n, nx), (n, nu) -> (n, nx)."""
        return np.einsum("nlj,l->nj", self.basis.evaluate_gradient(x, u), self.coefficients)

    def box_range(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Lower and upper bound of g over each box: (n, nx), (n, nx), (n, nu) -> (n,), (n,)."""
        centre = 0.5 * (xlo + xhi)
        r = 0.5 * (xhi - xlo) * (1.0 + 2.0**-50)
        middle, slopes = self.values(centre, u), self.slopes(centre, u)
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


_ROUNDS = 400
_BOXES = 2_000_000


def supremum(form: Form, inputs: Floats, tolerance: float = 1e-7) -> tuple[float, float]:
    """Bracket (value reached, upper bound) of sup of g over the domain and the inputs (M, nu).

    Boxes of the domain, one set for each input, are halved along the axis that widens their range most; a box whose
    upper bound is below the best value found is dropped. Stops when the bracket is `tolerance` of the range of g, or
    as narrow as rounding allows.

    Raises:
        BrokenPromise: when the bracket does not close within the budget of boxes.
    """
    m = len(inputs)
    lo, hi = np.tile(form.domain.lo, (m, 1)), np.tile(form.domain.hi, (m, 1))
    which, done = np.arange(m), 0
    best, scale, top = -np.inf, 0.0, np.inf
    for _ in range(_ROUNDS):
        below, above = form.box_range(lo, hi, inputs[which])
        best = max(best, float(form.values(0.5 * (lo + hi), inputs[which]).max()))
        scale = max(scale, float(above.max() - below.min()))
        top = float(above.max())
        if top - best <= max(tolerance * scale, 4.0 * form.rounding):
            return best, top
        keep = above > best
        lo, hi, which = lo[keep], hi[keep], which[keep]
        done += len(lo)
        if done > _BOXES:
            break
        lo, hi, which = _halved(form, lo, hi, which, inputs)
    raise BrokenPromise(
        f"the supremum of a gap bound is only known to lie in [{best:.6g}, {top:.6g}]",
        "Use a basis with fewer or smoother terms.",
    )


def _halved(form: Form, lo: Floats, hi: Floats, which: Ints, inputs: Floats) -> tuple[Floats, Floats, Ints]:
    r, middle = 0.5 * (hi - lo), 0.5 * (lo + hi)
    spread = np.abs(form.slopes(middle, inputs[which])) * r + 0.5 * r * (r @ form.hessian_bound)
    rows, axis = np.arange(len(lo)), spread.argmax(axis=1)
    left, right = hi.copy(), lo.copy()
    left[rows, axis] = right[rows, axis] = middle[rows, axis]
    return np.concatenate([lo, right]), np.concatenate([left, hi]), np.concatenate([which, which])


_POINTS = 1000  # of X, at which the sides of a formula are compared
_INPUTS = 50


@dataclass(frozen=True, eq=False)
class LinearGap(GapFunction):
    """`lower[i] <= d_i <= upper[i]` with forms over one basis; unsigned bounds have lower = -upper."""

    lower: tuple[Form, ...]
    upper: tuple[Form, ...]

    @staticmethod
    def unsigned(domain: GapDomain, tiers: Sequence[Tier], gamma: Sequence[Form]) -> LinearGap:
        """`|d_i| <= gamma_i`."""
        return LinearGap(domain, tuple(tiers), tuple(negated(g) for g in gamma), tuple(gamma))

    @property
    def basis(self) -> Basis:
        """The terms that all sides share."""
        return self.upper[0].basis

    def _box_bounds(self, xlo: Floats, xhi: Floats, u: Floats) -> tuple[Floats, Floats]:
        lo = [f.box_range(xlo, xhi, u)[0] for f in self.lower]
        hi = [f.box_range(xlo, xhi, u)[1] for f in self.upper]
        return np.stack(lo, axis=1), np.stack(hi, axis=1)

    @cached_property
    def _suprema(self) -> dict[str, GapSuprema]:
        found = {}
        for name, lo, hi in zip(self.domain.states, self.lower, self.upper, strict=True):
            tops = [supremum(f, self.domain.input_set)[1] for f in (hi, negated(lo), difference(hi, lo))]
            found[name] = GapSuprema(max(tops[0], tops[1]), tops[2])
        return found

    def sup(self) -> dict[str, GapSuprema]:
        """Suprema by branch and bound, upper ends of the brackets."""
        return self._suprema

    def narrowest(self) -> Floats:
        """(nx,) rigorous lower bound of hi - lo over X x U; at least 0 for a bound that is never upside down."""
        pairs = zip(self.lower, self.upper, strict=True)
        return np.array([-supremum(difference(lo, hi), self.domain.input_set)[1] for lo, hi in pairs])

    def raised(self, below: Floats, above: Floats) -> LinearGap:
        """lo - below, hi + above; both (nx,)."""
        lower = tuple(f.with_offset(f.offset - float(b)) for f, b in zip(self.lower, below, strict=True))
        upper = tuple(f.with_offset(f.offset + float(a)) for f, a in zip(self.upper, above, strict=True))
        return replace(self, lower=lower, upper=upper)

    def _kernel(self) -> Kernel:
        """See `GapFunction._kernel`: centred form with constant second derivatives and a constant for rounding."""
        nx, forms = len(self.domain.states), [*self.lower, *self.upper]
        run = compile_kernel(*_kernel_exprs(self.basis, forms))
        q = np.concatenate([[*f.coefficients, f.offset] for f in forms])
        curvature = np.concatenate([0.5 * f.hessian_bound.ravel() for f in forms])
        rounding = np.array([f.rounding for f in forms])
        halves = np.array([0.5, 0.5 * (1.0 + 2.0**-50)])
        lower_limit, upper_limit = self.domain.limits()

        @cached_kernel
        def bounds_over_box(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
            inside = True
            for j in range(nx):
                inside = inside and xlo[j] >= lower_limit[j] and xhi[j] <= upper_limit[j]
            out = run(xlo, xhi, u, q, curvature, rounding, halves)
            for i in range(nx):
                lo[i] = out[i] if inside else -np.inf
                hi[i] = out[nx + i] if inside else np.inf

        return bounds_over_box

    def _content(self) -> dict[str, Any]:
        sides = {
            name: {"lower": _side_json(lo), "upper": _side_json(hi)}
            for name, lo, hi in zip(self.domain.states, self.lower, self.upper, strict=True)
        }
        return {"kind": "linear", "meaning": "lower <= simulator - nominal <= upper", "gap": sides}

    @classmethod
    def from_content(cls, data: Mapping[str, Any], domain: GapDomain, tiers: tuple[Tier, ...]) -> LinearGap:
        """The inverse of `_content`."""
        sides = [data["gap"][name] for name in domain.states]
        terms = tuple(sides[0]["upper"]["coefficients"])
        basis = Basis(terms, domain.states, domain.inputs)
        first = make_form(basis, domain.box, domain.input_set, np.zeros(len(terms)))

        def side(entry: Mapping[str, Any]) -> Form:
            if tuple(entry["coefficients"]) != terms:
                raise UserError(
                    "the sides of a saved gap bound have different bases", remedy="Run the gap stage again."
                )
            q = np.array([float(v) for v in entry["coefficients"].values()])
            return replace(first, coefficients=q, offset=float(entry["offset"]))

        return cls(domain, tiers, tuple(side(s["lower"]) for s in sides), tuple(side(s["upper"]) for s in sides))

    def check(self) -> None:
        """See `GapFunction.check`; the sides are compared on a mesh of X."""
        for form in (*self.lower, *self.upper):
            require_finite("a row of coefficients", form.coefficients, (self.basis.size,))
            require(np.isfinite(form.offset), "an offset is not a finite number")
        box, inputs = self.domain.box, self.domain.input_set
        axis = max(2, int(_POINTS ** (1.0 / box.size)))
        grid = Grid(box, [axis] * box.size)
        x = np.concatenate([grid.centres(), mesh(*np.stack([box.lo, box.hi], axis=1))])
        chosen = inputs[np.unique(np.linspace(0, len(inputs) - 1, _INPUTS).astype(int))]
        every, each = np.repeat(x, len(chosen), axis=0), np.tile(chosen, (len(x), 1))
        require_sides(*self.bounds(every, each), every.shape, " on X")


def _side_json(form: Form) -> dict[str, Any]:
    q = {t: float(v) for t, v in zip(form.basis.terms, form.coefficients, strict=True)}
    text = " + ".join(f"{v:.4g}*{t}" for t, v in q.items() if v != 0.0)
    return {"formula": f"{text or '0'} + {form.offset:.4g}", "coefficients": q, "offset": form.offset}


def _kernel_exprs(basis: Basis, forms: Sequence[Form]) -> tuple[list[sp.Expr], list[list[sp.Symbol]]]:
    """Lower ends of the first half of the forms and upper ends of the second, over boxes, as expressions.

    Coefficients are symbols, bound at run time, so that no digit is lost in generated code.
    """
    nx, z = len(basis.states), basis.size
    xs = [symbol(s) for s in basis.states]
    xlo, xhi = sp.symbols(f"box_lo_:{nx}", real=True), sp.symbols(f"box_hi_:{nx}", real=True)
    q = sp.symbols(f"coefficient_:{len(forms) * (z + 1)}", real=True)
    h = sp.symbols(f"curvature_:{len(forms) * nx * nx}", real=True)
    e = sp.symbols(f"rounding_:{len(forms)}", real=True)
    half, more = sp.symbols("half more", real=True)
    centre = {x: half * (a + b) for x, a, b in zip(xs, xlo, xhi, strict=True)}
    r = [more * (b - a) for a, b in zip(xlo, xhi, strict=True)]
    out = []
    for k, form in enumerate(forms):
        own = q[k * (z + 1) : (k + 1) * (z + 1)]
        active = [(own[n], n) for n in range(z) if form.coefficients[n] != 0.0]
        value = sum((c * basis.exprs[n] for c, n in active), sp.Integer(0)) + own[z]
        slopes = [sum((c * basis.gradients[n][j] for c, n in active), sp.Integer(0)) for j in range(nx)]
        spread = sum((sp.Abs(s) * r[j] for j, s in enumerate(slopes)), sp.Integer(0))
        bend = form.hessian_bound
        spread += sum(
            (h[(k * nx + i) * nx + j] * r[i] * r[j] for i in range(nx) for j in range(nx) if bend[i, j]), sp.Integer(0)
        )
        sign = -1 if k < len(forms) // 2 else 1
        out.append((value + sign * (spread + e[k])).xreplace(centre))
    groups = [xlo, xhi, [symbol(s) for s in basis.inputs], q, h, e, [half, more]]
    return out, [list(g) for g in groups]
