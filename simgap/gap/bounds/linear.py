"""Gap function whose sides are linear in a basis: `lo_i = q.p(x, u) + c`, `hi_i = r.p(x, u) + e`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.basis import Basis, Form, difference, make_form, negated, supremum
from simgap.gap.bounds.function import (
    GapDomain,
    GapFunction,
    GapSuprema,
    Kernel,
    Tier,
    require,
    require_finite,
    require_sides,
)
from simgap.geometry import Grid, mesh
from simgap.late import sympy as sp
from simgap.model.compile import compile_kernel
from simgap.model.kernel_cache import cached_kernel
from simgap.model.symbolic import symbol

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
