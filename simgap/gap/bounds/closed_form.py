"""The gap of a simulator that is known in closed form, enclosed on every cell: nothing about it is estimated.

Both maps are expressions, so their difference `d = f_hat - f` is one, in exact rational numbers (their floating-point
coefficients are rational numbers), and terms that both have cancel. Interval arithmetic, rounded outward, then encloses

- its slope over a cell: by the mean value theorem d moves by no more than `sum_j sup |d_j d| h_j` from its centre
  (for a kink the slope is the interval between its one-sided slopes, which is what the theorem needs);
- its value over a cell, which is all that there is across a jump (dry friction), and its value at the centre.

What is executed is not the expression but its evaluation in floating point; `rounding` bounds the difference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.enclosures import enclose
from simgap.geometry import Grid
from simgap.late import sympy as sp
from simgap.model.compile import Kernel, compile_interval_kernel
from simgap.model.sampled import NominalModel, over_boxes

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
