"""The nominal model: the sampled map f, compiled, with its Jacobian and bounds over boxes.

An integrator gives f as expressions. Those of the classical Runge-Kutta step may be too large: written out, the fourth
stage holds F in F in F in F, of a Furuta pendulum, whose F has 74 operations, 24,913, which numba does not compile in
250 s. So it is a loop over its stages where they are; kernels of F and dF/dx are compiled once each and called four
times a step. With `y_s = x + a_s h k_(s-1)` the stages and the step are

    k_s = F(y_s, u),    f(x, u) = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4)

(Hairer, Noersett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1), and by the chain rule

    dk_s/dx = F'(y_s, u) (I + a_s h dk_(s-1)/dx),    df/dx = I + h/6 (dk_1/dx + 2 dk_2/dx + 2 dk_3/dx + dk_4/dx).

The interval kernels do the same in outward rounded interval arithmetic, so that they enclose f and df/dx over a box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike

from simgap.arrays import Bools, Floats
from simgap.geometry import rows
from simgap.late import sympy as sp
from simgap.model.compile import Kernel, cached_kernel, compile_interval_kernel, compile_kernel
from simgap.model.integrators import Exprs, discretise, rk4_exprs
from simgap.model.interval import iadd, imul
from simgap.model.symbolic import SymbolicModel

Axes = frozenset[int]
MOST_OPERATIONS = 3_000
"""Operations of a row of a map: with more, enclosing it on every cell takes longer than an engine would (judgement)."""


@dataclass(frozen=True, eq=False)
class NominalModel:
    """The map `x+ = f(x, u)` over one sampling time tau (paper, eq. disc_mathematical_model).

    `rule` holds one expression a state, over the symbols in `x` and `u` alone. Kernels are compiled when first used.
    """

    x: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    rule: Exprs
    tau: float

    @cached_property
    def f(self) -> Exprs:
        """One expression a state."""
        return self.rule

    @property
    def operations(self) -> int:
        """Number of operations to be compiled."""
        return sum(int(sp.count_ops(e)) for e in self.rule)

    @property
    def operations_of_an_image(self) -> int:
        """Number of operations by which f is enclosed over a box, what its expressions have in common counted once."""
        return _once(self.f) + _once(self.jacobian_exprs)

    @property
    def too_long_to_write_out(self) -> bool:
        """True if the map is a step whose expressions, written out, are too many to be enclosed by intervals."""
        return False

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
        return compile_kernel(self.f, (self.x, self.u))

    @cached_property
    def interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> lo, hi by two indices: f over the box, outward rounded."""
        return compile_interval_kernel(self.f, (self.x, self.u))

    @cached_property
    def jacobian_interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> lo, hi by two indices, the first row-major, of d f_i / d x_j over the box."""
        return compile_interval_kernel(self.jacobian_exprs, (self.x, self.u))

    @cached_property
    def offset_axes(self) -> tuple[Axes, ...]:
        """For each i, the state axes on which f_i - x_i depends."""
        return _axes(self._reads(tuple(sp.expand(f - x) for f, x in zip(self.f, self.x, strict=True))))

    @cached_property
    def jacobian_axes(self) -> tuple[tuple[Axes, ...], ...]:
        """For each i, j, the state axes on which d f_i / d x_j depends."""
        return tuple(_axes(row) for row in self._reads(self.jacobian_exprs).reshape(self.nx, self.nx, self.nx))

    def _reads(self, exprs: Exprs) -> Bools:
        """Which states each expression holds, (len(exprs), nx)."""
        return np.array([[s in sp.sympify(e).free_symbols for s in self.x] for e in exprs], dtype=np.bool_)

    def step(self, x: ArrayLike, u: ArrayLike) -> Floats:
        """f on arrays: (n, nx), (n, nu) -> (n, nx).

        Raises:
            UserError: rows of another size, or not as many of one as of the other.
        """
        return _over_points(self.kernel)(*rows((x, self.x), (u, self.u)), self.nx)

    def enclosure(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """f over boxes: (n, nx), (n, nx), (n, nu) -> two (n, nx), rounded outward."""
        return over_boxes(self.interval_kernel)(*self._boxes(lo, hi, u), self.nx)

    def jacobian_enclosure(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        """df_i/dx_j over boxes: (n, nx), (n, nx), (n, nu) -> two (n, nx, nx), rounded outward."""
        low, high = over_boxes(self.jacobian_interval_kernel)(*self._boxes(lo, hi, u), self.nx**2)
        shape = (-1, self.nx, self.nx)
        return low.reshape(shape), high.reshape(shape)

    def _boxes(self, lo: ArrayLike, hi: ArrayLike, u: ArrayLike) -> tuple[Floats, ...]:
        return rows((lo, self.x), (hi, self.x), (u, self.u))


@dataclass(frozen=True, eq=False)
class RungeKutta(NominalModel):
    """A step of length tau of `dx/dt = rule(x, u)`, u held, taken stage by stage."""

    @cached_property
    def f(self) -> Exprs:
        """The step written out."""
        return rk4_exprs(self.x, self.rule, sp.Float(self.tau))

    @cached_property
    def slopes(self) -> Exprs:
        """d rule_i / d x_j in row-major order."""
        return tuple(sp.diff(e, s) for e in self.rule for s in self.x)

    def written_out(self) -> int:
        """About how many operations the step written out has, without writing it out."""
        own = [int(sp.count_ops(e)) for e in self.rule]
        held = [[sum(1 for a in sp.preorder_traversal(e) if a == s) for s in self.x] for e in self.rule]
        total, stage = sum(own), own
        for _ in range(1, STAGES):
            stage = [n + sum(k * (stage[j] + 2) for j, k in enumerate(row)) for n, row in zip(own, held, strict=True)]
            total += sum(stage)
        return total

    @property
    def operations_of_an_image(self) -> int:
        """See `NominalModel.operations_of_an_image`."""
        return (2 * STAGES - 1) * _once(self.rule) + STAGES * _once(self.slopes)

    @property
    def too_long_to_write_out(self) -> bool:
        """See `NominalModel.too_long_to_write_out`."""
        return self.written_out() > MOST_OPERATIONS * self.nx

    @cached_property
    def kernel(self) -> Kernel:
        """numba: (x (nx,), u (nu,)) -> (nx,)."""
        return _step(compile_kernel(self.rule, (self.x, self.u)), self.nx, float(self.tau))

    @cached_property
    def interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> (nx, 2), lower and upper ends of f over the box, outward rounded."""
        return _interval_step(compile_interval_kernel(self.rule, (self.x, self.u)), self.nx, float(self.tau))

    @cached_property
    def jacobian_interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> (nx^2, 2), ends of d f_i / d x_j over the box in row-major order."""
        flow, slopes = (compile_interval_kernel(e, (self.x, self.u)) for e in (self.rule, self.slopes))
        return _interval_slopes(flow, slopes, self._sloped, self.nx, float(self.tau))

    @cached_property
    def offset_axes(self) -> tuple[Axes, ...]:
        """For each i, state axes on which f_i - x_i may depend: what its stages read."""
        return _axes(np.logical_or.reduce([self._reads(self.rule) @ points for points in self._points]))

    @cached_property
    def jacobian_axes(self) -> tuple[tuple[Axes, ...], ...]:
        """For each i, j, state axes on which d f_i / d x_j may depend: by the chain rule, stage by stage."""
        n, slopes = self.nx, self._reads(self.slopes).reshape(self.nx, self.nx, self.nx)
        axes: Bools = np.zeros((n, n, n), np.bool_)  # of dk_s/dx
        there: Bools = np.zeros((n, n), np.bool_)  # where it is not 0
        total = axes
        for points in self._points:
            along = self._sloped[:, :, None] & (there | np.eye(n, dtype=np.bool_))  # (i, m, j)
            axes = np.any(along[..., None] & ((slopes @ points)[:, :, None] | axes), axis=1)
            there, total = np.any(along, axis=1), total | axes
        return tuple(_axes(row) for row in total)

    @cached_property
    def _sloped(self) -> Bools:
        """Where d rule_i / d x_j is not 0, (nx, nx)."""
        return np.array([e != 0 for e in self.slopes], dtype=np.bool_).reshape(self.nx, self.nx)

    @cached_property
    def _points(self) -> list[Bools]:
        """For each stage the states on which its point y_s may depend, (nx, nx)."""
        own, found = self._reads(self.rule), [np.eye(self.nx, dtype=np.bool_)]
        for _ in range(1, STAGES):
            found.append(found[0] | own @ found[-1])
        return found


def _axes(reads: Bools) -> tuple[Axes, ...]:
    return tuple(frozenset(np.flatnonzero(row).tolist()) for row in reads)


STAGES = 4
_REACH = np.array([0.0, 0.5, 0.5, 1.0])
_WEIGHT = np.array([1.0, 2.0, 2.0, 1.0])


def _sixth(h: float) -> float:
    """The coefficient of `rk4_exprs`, so that both are the same map to the last bit of what they declare."""
    return float(sp.Float(h) / 6)


def _step(flow: Kernel, n: int, h: float) -> Kernel:
    reach, weight, sixth = h * _REACH, _WEIGHT.copy(), _sixth(h)

    @cached_kernel
    def runge_kutta_step(x, u):  # type: ignore[no-untyped-def]
        at, total = x.copy(), np.zeros(n)
        for s in range(4):
            k = flow(at, u)
            for i in range(n):
                total[i] += weight[s] * k[i]
                if s < 3:
                    at[i] = x[i] + reach[s + 1] * k[i]
        for i in range(n):
            total[i] = x[i] + sixth * total[i]
        return total

    return runge_kutta_step


def _interval_step(flow: Kernel, n: int, h: float) -> Kernel:
    reach, weight, sixth = h * _REACH, _WEIGHT.copy(), _sixth(h)

    @cached_kernel
    def runge_kutta_enclosure(xlo, xhi, ulo, uhi):  # type: ignore[no-untyped-def]
        lo, hi, out = xlo.copy(), xhi.copy(), np.zeros((n, 2))
        for s in range(4):
            k = flow(lo, hi, ulo, uhi)
            for i in range(n):
                part = imul((weight[s], weight[s]), k[i])
                out[i, 0], out[i, 1] = iadd((out[i, 0], out[i, 1]), part)
                if s < 3:
                    moved = imul((reach[s + 1], reach[s + 1]), k[i])
                    lo[i], hi[i] = iadd((xlo[i], xhi[i]), moved)
        for i in range(n):
            moved = imul((sixth, sixth), (out[i, 0], out[i, 1]))
            out[i, 0], out[i, 1] = iadd((xlo[i], xhi[i]), moved)
        return out

    return runge_kutta_enclosure


def _interval_slopes(flow: Kernel, slopes: Kernel, there: np.ndarray, n: int, h: float) -> Kernel:
    reach, weight, sixth = h * _REACH, _WEIGHT.copy(), _sixth(h)

    @cached_kernel
    def runge_kutta_slopes(xlo, xhi, ulo, uhi):  # type: ignore[no-untyped-def]
        lo, hi, out = xlo.copy(), xhi.copy(), np.zeros((n * n, 2))
        last, this = np.zeros((n, n, 2)), np.zeros((n, n, 2))
        for s in range(4):
            a = (reach[s], reach[s])
            for m in range(n):  # I + a h dk/dx of the stage before; the entries that are 0 stay exactly that
                for j in range(n):
                    if last[m, j, 0] != 0.0 or last[m, j, 1] != 0.0:
                        last[m, j, 0], last[m, j, 1] = imul(a, (last[m, j, 0], last[m, j, 1]))
                    if m == j:
                        last[m, j, 0], last[m, j, 1] = iadd((last[m, j, 0], last[m, j, 1]), (1.0, 1.0))
            slope = slopes(lo, hi, ulo, uhi)
            for i in range(n):
                for j in range(n):
                    total = (0.0, 0.0)
                    for m in range(n):
                        if there[i, m] and (last[m, j, 0] != 0.0 or last[m, j, 1] != 0.0):
                            total = iadd(total, imul(slope[i * n + m], (last[m, j, 0], last[m, j, 1])))
                    this[i, j, 0], this[i, j, 1] = total
                    if total[0] != 0.0 or total[1] != 0.0:
                        at = i * n + j
                        out[at, 0], out[at, 1] = iadd((out[at, 0], out[at, 1]), imul((weight[s], weight[s]), total))
            last[:], this[:] = this, 0.0
            if s < 3:
                k = flow(lo, hi, ulo, uhi)
                for i in range(n):
                    moved = imul((reach[s + 1], reach[s + 1]), k[i])
                    lo[i], hi[i] = iadd((xlo[i], xhi[i]), moved)
        for i in range(n):
            for j in range(n):
                at = i * n + j
                if out[at, 0] != 0.0 or out[at, 1] != 0.0:
                    out[at, 0], out[at, 1] = imul((sixth, sixth), (out[at, 0], out[at, 1]))
                if i == j:
                    out[at, 0], out[at, 1] = iadd((out[at, 0], out[at, 1]), (1.0, 1.0))
        return out

    return runge_kutta_slopes


WRITTEN_OUT = 1_000
"""Operations, by `RungeKutta.written_out`, of a step of rk4 up to which its expressions are compiled as they are.

Four equations of 362 operations by rk4 (estimated 866) take 3.7 CPU s written out, 2.1 by stages; a pendulum with three
kinds of friction, 1,565 (2,460), takes 6.0 and 1.6; one without, 54 (64), 1.4 either way.
"""


def sampled_model(model: SymbolicModel, tau: float, integrator: str) -> NominalModel:
    """The map of `discretise`, or where the expressions of rk4 would be large the step that is taken stage by stage.

    Raises:
        UserError: as `discretise`.
    """
    x, u = (tuple(v.symbol for v in group) for group in (model.states, model.inputs))
    if integrator == "rk4":
        step = RungeKutta(x, u, model.numeric(), tau)
        if step.written_out() > WRITTEN_OUT:
            return step
    return NominalModel(x, u, discretise(model, tau, integrator), tau)


def _once(exprs: Exprs) -> int:
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
def over_boxes(kernel: Kernel) -> Kernel:
    """numba: (lo (n, nx), hi (n, nx), u (n, nu), size) -> two (n, size), the ends that an interval kernel gives."""

    @cached_kernel
    def each_box(lo: Floats, hi: Floats, u: Floats, size: int) -> tuple[Floats, Floats]:
        low, high = np.empty((lo.shape[0], size)), np.empty((lo.shape[0], size))
        for k in range(lo.shape[0]):
            values = kernel(lo[k], hi[k], u[k], u[k])
            for i in range(size):
                low[k, i], high[k, i] = values[i][0], values[i][1]
        return low, high

    return each_box
