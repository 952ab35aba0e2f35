"""Ranges of expressions over a box with a bound of their rounding, and with them of a gap that is known in closed form.

An `Enclosure` (lo, hi, error) of an expression over a box says two things: the exact value lies in [lo, hi] at every
point of the box, and evaluating the expression in double precision, with sums and products in any order, is off by at
most `error`. The second is a running error analysis (Higham, Accuracy and Stability of Numerical Algorithms,
section 3.3) over the expression tree, with magnitudes from the first; it is computed once for a basis and makes
rounding outward cost one addition afterwards.

Where simulator and model are both expressions, so is their difference `d = f_hat - f`, in exact rational numbers (their
floating-point coefficients are rational numbers), and terms that both have cancel. Interval arithmetic, rounded
outward, then encloses on every cell

- its slope: by the mean value theorem d moves by no more than `sum_j sup |d_j d| h_j` from the centre (for a kink the
  slope is the interval between its one-sided slopes, which is what the theorem needs);
- its value, which is all that there is across a jump (dry friction), and its value at the centre.

What is executed is not the expression but its evaluation in floating point; `ClosedFormGap.rounding` bounds the
difference. So nothing about such a gap is estimated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Grid
from simgap.late import interpreted
from simgap.late import sympy as sp
from simgap.model import interval as compiled
from simgap.model.compile import Kernel, compile_interval_kernel
from simgap.model.sampled import NominalModel, over_boxes

interval = interpreted(compiled)  # a few calls are no reason to wait for a compiler
_UNIT = 2.0**-52  # twice the unit roundoff: covers second-order terms
_LIBM = 2.0**-49  # library functions, a few units in the last place
_LITERAL = 2.0**-46  # generated code may print a literal to 15 digits only
_TINY = 1e-300
_FINITE = "Leave out of X where it is not, or write it in terms that are finite everywhere."
_KNOWN = "Use powers, sin, cos, tan, atan, tanh, exp, log, sqrt."

_MONOTONE_SLOPE = {"sin": 1.0, "cos": 1.0, "tanh": 1.0, "atan": 1.0, "sign": 0.0, "Abs": 1.0}


@dataclass(frozen=True)
class Enclosure:
    """Range [lo, hi] of exact values and bound `error` of the rounding of the computed ones."""

    lo: float
    hi: float
    error: float = 0.0

    @property
    def magnitude(self) -> float:
        """Largest absolute exact value."""
        return max(abs(self.lo), abs(self.hi))

    @property
    def pair(self) -> tuple[float, float]:
        """(lo, hi)."""
        return self.lo, self.hi


def enclose(expr: sp.Expr, box: Mapping[sp.Symbol, tuple[float, float]]) -> Enclosure:
    """Range and rounding of `expr` over `box` (symbol -> (lower, upper)).

    Raises:
        UserError: where the expression is not finite on the box, or holds a function without an interval version.
    """
    result = _visit(sp.sympify(expr), box)
    if not (math.isfinite(result.lo) and math.isfinite(result.hi) and math.isfinite(result.error)):
        raise UserError(f"'{expr}' is not shown to be bounded on the state and input sets", remedy=_FINITE)
    return result


def _visit(e: sp.Expr, box: Mapping[sp.Symbol, tuple[float, float]]) -> Enclosure:
    if e.is_Symbol:
        if e not in box:
            raise UserError(f"'{e}' is neither a state nor an input")
        lo, hi = box[e]
        return Enclosure(float(lo), float(hi))
    if e.is_number:
        return _number(e)
    parts = [_visit(a, box) for a in e.args]
    if e.is_Add:
        return _add(parts)
    if e.is_Mul:
        return _product(parts)
    if e.is_Pow:
        return _pow(e, parts[0])
    if isinstance(e, sp.Min | sp.Max):
        return _extreme(e, parts)
    return _function(e, parts)


def _number(e: sp.Expr) -> Enclosure:
    value = float(e)
    if e.is_Integer and abs(int(e)) <= 2**53:
        return Enclosure(value, value)
    slack = abs(value) * _LITERAL + _TINY
    return Enclosure(value - slack, value + slack, slack)


def _add(parts: list[Enclosure]) -> Enclosure:
    size = sum(p.magnitude + p.error for p in parts)
    error = sum(p.error for p in parts) + len(parts) * _UNIT * size
    return Enclosure(*reduce(interval.iadd, [p.pair for p in parts]), error)


def _product(parts: list[Enclosure]) -> Enclosure:
    total = parts[0]
    for p in parts[1:]:
        a, b = total.magnitude, p.magnitude
        error = a * p.error + b * total.error + total.error * p.error
        error += _UNIT * (a + total.error) * (b + p.error) + _TINY
        lo, hi = interval.imul(total.pair, p.pair)
        total = Enclosure(lo, hi, error)
    return total


def _pow(e: sp.Pow, base: Enclosure) -> Enclosure:
    exponent = e.exp
    if exponent.is_Float and exponent == int(exponent):
        exponent = sp.Integer(int(exponent))
    if not exponent.is_Integer and (2 * exponent).is_Integer:
        base, exponent = _sqrt(e, base), 2 * exponent
    if not exponent.is_Integer:
        raise UserError(f"'{e}' has a power without an interval version", remedy="Use integer powers or sqrt.")
    n = abs(int(exponent))
    size = base.magnitude + base.error
    error = n * size ** (n - 1) * base.error + 4.0 * n * _UNIT * size**n + _TINY
    lo, hi = interval.ipow(base.pair, n)
    power = Enclosure(lo, hi, error)
    return power if exponent > 0 else _inverse(e, power)


def _inverse(e: sp.Expr, a: Enclosure) -> Enclosure:
    lo, hi = interval.iinv(a.pair)
    nearest = min(abs(a.lo), abs(a.hi)) - a.error
    if not math.isfinite(lo) or nearest <= 0.0:
        raise UserError(f"'{e}' divides by what may be 0 on the state and input sets", remedy=_FINITE)
    return Enclosure(lo, hi, a.error / nearest**2 + _UNIT / nearest)


def _sqrt(e: sp.Expr, a: Enclosure) -> Enclosure:
    if a.lo < 0.0:
        raise UserError(f"'{e}' takes the root of what may be negative on the state and input sets", remedy=_FINITE)
    lo, hi = interval.isqrt(a.pair)
    error = math.sqrt(a.error) if a.lo <= a.error else a.error / math.sqrt(a.lo - a.error)
    return Enclosure(lo, hi, error + _LIBM * hi)


def _extreme(e: sp.Expr, parts: list[Enclosure]) -> Enclosure:
    join = interval.imin if isinstance(e, sp.Min) else interval.imax
    return Enclosure(*reduce(join, [p.pair for p in parts]), max(p.error for p in parts))


def _function(e: sp.Expr, parts: list[Enclosure]) -> Enclosure:
    name = type(e).__name__
    primitive = getattr(interval, "i" + name.lower(), None)
    if primitive is None or len(parts) != 1:
        raise UserError(f"'{e}' has no interval version", remedy=_KNOWN)
    a = parts[0]
    try:
        lo, hi = (float(v) for v in primitive(a.pair))
    except (OverflowError, ValueError):  # of Python, where compiled code has an infinity
        lo, hi = -math.inf, math.inf
    if name == "sign" and a.error > 0.0 and a.lo <= a.error and a.hi >= -a.error:
        return Enclosure(lo, hi, 2.0)  # a rounded argument may fall on the other side of the jump
    if name in _MONOTONE_SLOPE:
        slope = _MONOTONE_SLOPE[name]
    elif name == "exp":
        slope = hi * math.exp(min(a.error, 1.0)) if a.error <= 1.0 else math.inf
    elif name == "tan":
        slope = 2.0 * (1.0 + max(abs(lo), abs(hi)) ** 2)
    elif name == "log" and a.lo > a.error:
        slope = 1.0 / (a.lo - a.error)
    else:
        raise UserError(f"'{e}' is not shown to be bounded on the state and input sets", remedy=_FINITE)
    return Enclosure(lo, hi, slope * a.error + _LIBM * max(abs(lo), abs(hi)) + _TINY)


_SMALL = 500  # operations up to which a row is multiplied out, in case that makes it shorter
_FEW = 1000
"""Terms up to which it is: two Runge-Kutta steps of (i/z)^2 are 399 operations whose expansion did not end in minutes.
The rows of the shipped cases have at most 148. Judgement."""
_WIDER = 1.0 + 2.0**-40  # of a cell: its borders are rounded


@dataclass(frozen=True, eq=False)
class CellRanges:
    """Enclosures of one dimension of the gap on N cells for M inputs.

    Attributes:
        slope_lo, slope_hi: (N, M, nx) of d_i's derivative over each cell; infinite where it jumps.
        lo, hi: (N, M) of d_i over each cell. centre_lo, centre_hi: (N, M) of d_i at its centre.
        rounding: bound of |computed - exact| of d_i anywhere.
        reach: (nx,) half-widths of a cell, its rounding included.
    """

    slope_lo: Floats
    slope_hi: Floats
    lo: Floats
    hi: Floats
    centre_lo: Floats
    centre_hi: Floats
    rounding: float
    reach: Floats

    def check_samples(self, d: Floats, name: str) -> None:
        """Hold sampled values (N, M) against their enclosures.

        Raises:
            BrokenPromise: a sample that is not the value of the expression: the engine does not do what it says.
        """
        slack = self.rounding + 2.0**-52 * np.abs(d)
        off = np.maximum(self.centre_lo - d, d - self.centre_hi) - slack
        if not (off <= 0.0).all():
            raise BrokenPromise(
                f"the roll-outs are not those of the equations: {name} is off by up to {float(np.nanmax(off)):.3g}",
                "Run the rollouts stage again.",
            )


@dataclass(frozen=True, eq=False)
class ClosedFormGap:
    """`d = f_hat - f` over states `x` and inputs `u`: one expression a state, in exact numbers.

    Raises:
        UserError: a piecewise map, whose jumps derivatives do not see.
    """

    x: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    simulator: tuple[sp.Expr, ...]
    nominal: tuple[sp.Expr, ...]

    def __post_init__(self) -> None:
        for row, name in zip((*self.simulator, *self.nominal), (*self.x, *self.x), strict=True):
            if sp.sympify(row).has(sp.Piecewise):
                raise UserError(
                    f"the gap of {name} is piecewise and cannot be enclosed", key="simulator.engine",
                    remedy="Write it with min, max, abs and sign.",
                )  # fmt: skip

    @staticmethod
    def of(simulator: Sequence[sp.Expr], model: NominalModel) -> ClosedFormGap:
        """The gap between a simulator's map and the nominal one."""
        return ClosedFormGap(model.x, model.u, tuple(exact(e) for e in simulator), tuple(exact(e) for e in model.f))

    @cached_property
    def d(self) -> tuple[sp.Expr, ...]:
        """One expression a state; what both maps have in common is gone."""
        return tuple(_short(a - b) for a, b in zip(self.simulator, self.nominal, strict=True))

    def rounding(self, i: int, lo: Floats, hi: Floats, inputs: Floats) -> float:
        """Bound of the rounding of d_i, computed as the difference of two computed steps, on a box (nx,) and U (M, nu).

        Raises:
            UserError: where a map is not finite there.
        """
        box: Mapping[sp.Symbol, tuple[float, float]] = dict(zip(self.x, zip(lo, hi, strict=True), strict=True))
        box = {**box, **{s: (inputs[:, k].min(), inputs[:, k].max()) for k, s in enumerate(self.u)}}
        ends = [enclose(row[i], box) for row in (self.simulator, self.nominal)]
        return sum(e.error + 2.0**-52 * e.magnitude for e in ends)

    def ranges(self, i: int, grid: Grid, inputs: Floats) -> CellRanges:
        """Enclosures of dimension i on every cell of the grid for every input (M, nu).

        Raises:
            UserError: an expression without an interval version, or one that is not bounded on a cell.
        """
        rounding = self.rounding(i, grid.box.lo, grid.box.hi, inputs)  # first: it names the term that is not bounded
        c, reach = grid.centres(), self.reach(grid)
        groups = (self.x, self.u)
        slopes = compile_interval_kernel([sp.diff(self.d[i], s) for s in self.x], groups)
        value = compile_interval_kernel([self.d[i]], groups)
        slope_lo, slope_hi = _over_cells(slopes, c - reach, c + reach, inputs, len(self.x))
        lo, hi = _over_cells(value, c - reach, c + reach, inputs, 1)
        centre_lo, centre_hi = _over_cells(value, c, c, inputs, 1)
        if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
            raise UserError(
                f"the gap of {self.x[i]} is not shown to be bounded on X and U",
                key="simulator",
                remedy="Write it in terms that are finite everywhere, or set simulator.slopes: sampled.",
            )
        undefined = np.isnan(slope_lo) | np.isnan(slope_hi)
        slope_lo[undefined], slope_hi[undefined] = -np.inf, np.inf
        sides = lo[..., 0], hi[..., 0], centre_lo[..., 0], centre_hi[..., 0]
        return CellRanges(slope_lo, slope_hi, *sides, rounding, reach)

    def reach(self, grid: Grid) -> Floats:
        """(nx,) half-widths of a cell around its computed centre that leave no gap to its neighbours."""
        return grid.h * _WIDER + 2.0**-50 * np.maximum(np.abs(grid.box.lo), np.abs(grid.box.hi))


def exact(e: Any) -> sp.Expr:
    """The expression with every floating-point number as the rational number that it is."""
    e = sp.sympify(e)
    return e.xreplace({f: sp.Rational(float(f)) for f in e.atoms(sp.Float)})


def _short(e: sp.Expr) -> sp.Expr:
    """The expression, or the same multiplied out where that is shorter: fewer terms are narrower enclosures.

    What stands below a fraction bar stays as it is: multiplied out, nested ones grow without end.
    """
    below = {p: sp.Dummy() for p in e.atoms(sp.Pow) if p.exp.is_negative and p.base.is_Add}
    above = e.xreplace(below)
    if sp.count_ops(e) > _SMALL or _most_terms(above) > _FEW:
        return e
    whole = sp.expand(above).xreplace({held: power for power, held in below.items()})
    return min(e, whole, key=sp.count_ops)


def _most_terms(e: sp.Expr) -> float:
    """At most how many terms any part of an expression has once it is multiplied out."""
    most = 1.0

    def terms(part: sp.Basic) -> float:
        nonlocal most
        own = [terms(a) for a in part.args]
        count = 1.0
        if isinstance(part, sp.Add):
            count = sum(own)
        elif isinstance(part, sp.Mul):
            count = math.prod(own)
        elif isinstance(part, sp.Pow) and part.exp.is_Integer:  # of n terms, all products of that many
            power = abs(int(part.exp))
            count = float(math.comb(int(own[0]) + power - 1, power)) if own[0] * power <= 100 * _FEW else math.inf
            count = 1.0 if own[0] == 1.0 else count
        most = max(most, count)
        return count

    terms(e)
    return most


def _over_cells(kernel: Kernel, lo: Floats, hi: Floats, inputs: Floats, size: int) -> tuple[Floats, Floats]:
    """Enclosures over boxes (N, nx), (N, nx) for each input (M, nu): two (N, M, size)."""
    low, high = over_boxes(kernel)(
        np.repeat(lo, len(inputs), axis=0), np.repeat(hi, len(inputs), axis=0), np.tile(inputs, (len(lo), 1)), size
    )
    return low.reshape(len(lo), -1, size), high.reshape(len(lo), -1, size)
