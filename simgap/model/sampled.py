"""The nominal model: the sampled map f, compiled, with its Jacobian and bounds over boxes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike

from simgap.arrays import Floats
from simgap.geometry import rows
from simgap.late import sympy as sp
from simgap.model.compile import Kernel, compile_interval_kernel, compile_kernel
from simgap.model.integrators import STAGES, RungeKutta
from simgap.model.kernel_cache import cached_kernel

MOST_OPERATIONS = 3_000
"""Operations of a row of a map: with more, enclosing it on every cell takes longer than an engine would (judgement)."""


@dataclass(frozen=True, eq=False)
class NominalModel:
    """The map `x+ = f(x, u)` over one sampling time tau (paper, eq. disc_mathematical_model).

    `rule` holds one expression a state, over the symbols in `x` and `u` alone, or a step whose expressions would be too
    large to compile. Kernels are compiled when first used.
    """

    x: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    rule: tuple[sp.Expr, ...] | RungeKutta
    tau: float

    @cached_property
    def f(self) -> tuple[sp.Expr, ...]:
        """One expression a state; written out first where the rule is a step."""
        return self.rule.written_out() if isinstance(self.rule, RungeKutta) else self.rule

    @property
    def operations(self) -> int:
        """Number of operations to be compiled."""
        rule = self.rule
        return sum(int(sp.count_ops(e)) for e in (rule.xdot if isinstance(rule, RungeKutta) else rule))

    @property
    def operations_of_an_image(self) -> int:
        """Number of operations by which f is enclosed over a box, what its expressions have in common counted once."""
        if isinstance(self.rule, RungeKutta):
            return (2 * STAGES - 1) * _once(self.rule.xdot) + STAGES * _once(self.rule.slopes)
        return _once(self.f) + _once(self.jacobian_exprs)

    @property
    def too_long_to_write_out(self) -> bool:
        """True if the map is a step whose expressions, written out, are too many to be enclosed by intervals."""
        return isinstance(self.rule, RungeKutta) and self.rule.operations() > MOST_OPERATIONS * self.nx

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.x)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.u)

    @cached_property
    def jacobian_exprs(self) -> tuple[sp.Expr, ...]:
        """d f_i / d x_j in row-major order."""
        return tuple(sp.diff(f, x) for f in self.f for x in self.x)

    @cached_property
    def kernel(self) -> Kernel:
        """numba: (x (nx,), u (nu,)) -> f_0, ... by index."""
        if isinstance(self.rule, RungeKutta):
            return self.rule.kernel
        return compile_kernel(self.f, (self.x, self.u))

    @cached_property
    def interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> lo, hi by two indices: f over the box, outward rounded."""
        if isinstance(self.rule, RungeKutta):
            return self.rule.interval_kernel
        return compile_interval_kernel(self.f, (self.x, self.u))

    @cached_property
    def jacobian_interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> lo, hi by two indices, the first row-major, of d f_i / d x_j over the box."""
        if isinstance(self.rule, RungeKutta):
            return self.rule.jacobian_interval_kernel
        return compile_interval_kernel(self.jacobian_exprs, (self.x, self.u))

    @cached_property
    def offset_axes(self) -> tuple[frozenset[int], ...]:
        """For each i, the state axes on which f_i - x_i depends."""
        if isinstance(self.rule, RungeKutta):
            return self.rule.offset_axes
        return tuple(self._axes(sp.expand(f - x)) for f, x in zip(self.f, self.x, strict=True))

    @cached_property
    def jacobian_axes(self) -> tuple[tuple[frozenset[int], ...], ...]:
        """For each i, j, the state axes on which d f_i / d x_j depends."""
        if isinstance(self.rule, RungeKutta):
            return self.rule.jacobian_axes
        axes = [self._axes(e) for e in self.jacobian_exprs]
        return tuple(tuple(axes[i * self.nx : (i + 1) * self.nx]) for i in range(self.nx))

    def _axes(self, expr: sp.Expr) -> frozenset[int]:
        return frozenset(j for j, s in enumerate(self.x) if s in expr.free_symbols)

    def step(self, x: ArrayLike, u: ArrayLike) -> Floats:
        """f on arrays: (n, nx), (n, nu) -> (n, nx).

        Raises:
            UserError: rows of another size, or not as many of one as of the other.
        """
        return _over_points(self.kernel)(*rows((x, self.x), (u, self.u)), self.nx)

    def enclosure(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """f over boxes: (n, nx), (n, nx), (n, nu) -> two (n, nx), rounded outward."""
        return _over_boxes(self.interval_kernel)(*self._boxes(lo, hi, u), self.nx)

    def jacobian_enclosure(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """df_i/dx_j over boxes: (n, nx), (n, nx), (n, nu) -> two (n, nx, nx), rounded outward."""
        low, high = _over_boxes(self.jacobian_interval_kernel)(*self._boxes(lo, hi, u), self.nx**2)
        shape = (-1, self.nx, self.nx)
        return low.reshape(shape), high.reshape(shape)

    def _boxes(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, ...]:
        return rows((lo, self.x), (hi, self.x), (u, self.u))


def _once(exprs: tuple[sp.Expr, ...]) -> int:
    parts, rest = sp.cse(exprs)
    return sum(int(sp.count_ops(e)) for e in (*(e for _, e in parts), *rest))


@cache
def _over_points(kernel: Kernel) -> Kernel:
    @cached_kernel
    def over_points(x: Floats, u: Floats, size: int) -> Floats:
        out = np.empty((x.shape[0], size))
        for k in range(x.shape[0]):
            values = kernel(x[k], u[k])
            for i in range(size):
                out[k, i] = values[i]
        return out

    return over_points


@cache
def _over_boxes(kernel: Kernel) -> Kernel:
    @cached_kernel
    def over_boxes(lo: Floats, hi: Floats, u: Floats, size: int) -> tuple[Floats, Floats]:
        low, high = np.empty((lo.shape[0], size)), np.empty((lo.shape[0], size))
        for k in range(lo.shape[0]):
            values = kernel(lo[k], hi[k], u[k], u[k])
            for i in range(size):
                low[k, i], high[k, i] = values[i][0], values[i][1]
        return low, high

    return over_boxes
