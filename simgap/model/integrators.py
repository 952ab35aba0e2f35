"""From `dx/dt = F(x, u)` to the sampled map `x+ = f(x, u)` over one sampling time, u held, and the path in between.

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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.compile import Kernel, compile_interval_kernel, compile_kernel
from simgap.model.interval import iadd, imul
from simgap.model.kernel_cache import cached_kernel
from simgap.model.symbolic import SymbolicModel, symbol

Exprs: TypeAlias = "tuple[sp.Expr, ...]"
Axes = frozenset[int]
STAGES = 4
_REACH = np.array([0.0, 0.5, 0.5, 1.0])
_WEIGHT = np.array([1.0, 2.0, 2.0, 1.0])


def rk4_exprs(x: Sequence[sp.Symbol], xdot: Exprs, h: sp.Expr) -> Exprs:
    """The step written out, one expression a state; its size grows with the fourth power of that of `xdot`."""

    def slope(at: Sequence[sp.Expr]) -> Exprs:
        values = dict(zip(x, at, strict=True))
        return tuple(sp.sympify(e).subs(values, simultaneous=True) for e in xdot)

    k1 = xdot
    k2 = slope([a + h / 2 * k for a, k in zip(x, k1, strict=True)])
    k3 = slope([a + h / 2 * k for a, k in zip(x, k2, strict=True)])
    k4 = slope([a + h * k for a, k in zip(x, k3, strict=True)])
    return tuple(a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True))


@dataclass(frozen=True, eq=False)
class RungeKutta:
    """A step of length h (s) of `dx/dt = xdot(x, u)`, u held, over the symbols in `x` and `u` alone."""

    x: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    xdot: Exprs
    h: float

    @cached_property
    def slopes(self) -> Exprs:
        """d xdot_i / d x_j in row-major order."""
        return tuple(sp.diff(e, s) for e in self.xdot for s in self.x)

    def written_out(self) -> Exprs:
        """The same map as expressions."""
        return rk4_exprs(self.x, self.xdot, sp.Float(self.h))

    def operations(self) -> int:
        """About how many operations the step written out has, without writing it out."""
        own = [int(sp.count_ops(e)) for e in self.xdot]
        held = [[sum(1 for a in sp.preorder_traversal(e) if a == s) for s in self.x] for e in self.xdot]
        total, stage = sum(own), own
        for _ in range(1, STAGES):
            stage = [n + sum(k * (stage[j] + 2) for j, k in enumerate(row)) for n, row in zip(own, held, strict=True)]
            total += sum(stage)
        return total

    @cached_property
    def kernel(self) -> Kernel:
        """numba: (x (nx,), u (nu,)) -> (nx,)."""
        return _step(compile_kernel(self.xdot, (self.x, self.u)), len(self.x), float(self.h))

    @cached_property
    def interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> (nx, 2), lower and upper ends of f over the box, outward rounded."""
        return _interval_step(compile_interval_kernel(self.xdot, (self.x, self.u)), len(self.x), float(self.h))

    @cached_property
    def jacobian_interval_kernel(self) -> Kernel:
        """numba: (xlo, xhi, ulo, uhi) -> (nx^2, 2), ends of d f_i / d x_j over the box in row-major order."""
        groups = (self.x, self.u)
        n = len(self.x)
        there = np.array([e != 0 for e in self.slopes]).reshape(n, n)
        flow, slopes = compile_interval_kernel(self.xdot, groups), compile_interval_kernel(self.slopes, groups)
        return _interval_slopes(flow, slopes, there, n, float(self.h))

    @cached_property
    def offset_axes(self) -> tuple[Axes, ...]:
        """For each i, state axes on which f_i - x_i may depend: what its stages read."""
        n = len(self.x)
        return tuple(frozenset().union(*(stage[i] for stage in self._rates)) for i in range(n))

    @cached_property
    def jacobian_axes(self) -> tuple[tuple[Axes, ...], ...]:
        """For each i, j, state axes on which d f_i / d x_j may depend."""
        n = len(self.x)
        read = [self._read(e) for e in self.slopes]
        total = [[frozenset[int]() for _ in range(n)] for _ in range(n)]
        last: list[list[Axes | None]] = [[None] * n for _ in range(n)]  # None: the entry is 0
        for s in range(STAGES):
            stage: list[list[Axes | None]] = [[None] * n for _ in range(n)]
            for i in range(n):
                for m in range(n):
                    if self.slopes[i * n + m] == 0:
                        continue
                    here = self._at_stage(read[i * n + m], s)
                    for j in range(n):
                        inner = last[m][j] if s else None
                        if m == j or inner is not None:
                            stage[i][j] = (stage[i][j] or frozenset()) | here | (inner or frozenset())
            for i in range(n):
                for j in range(n):
                    total[i][j] |= stage[i][j] or frozenset()
            last = stage
        return tuple(tuple(row) for row in total)

    @cached_property
    def _rates(self) -> list[list[Axes]]:
        """For each stage and i, the state axes on which k_i depends."""
        own = [self._read(e) for e in self.xdot]
        found = [own]
        for _ in range(1, STAGES):
            found.append([frozenset().union(axes, *(found[-1][j] for j in axes)) for axes in own])
        return found

    def _at_stage(self, axes: Axes, s: int) -> Axes:
        """State axes on which something depends that reads `axes` of the point of stage s."""
        return axes if s == 0 else frozenset().union(axes, *(self._rates[s - 1][j] for j in axes))

    def _read(self, expr: sp.Expr) -> Axes:
        return frozenset(j for j, s in enumerate(self.x) if s in sp.sympify(expr).free_symbols)


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
"""Operations, by `RungeKutta.operations`, of a step of rk4 up to which its expressions are compiled as they are.

Four equations of 362 operations by rk4 (estimated 866) take 3.7 CPU s written out, 2.1 by stages; a pendulum with three
kinds of friction, 1,565 (2,460), takes 6.0 and 1.6; one without, 54 (64), 1.4 either way.
"""


def sampling_rule(model: SymbolicModel, tau: float, integrator: str) -> Exprs | RungeKutta:
    """`discretise`, or where the expressions of rk4 would be large the step that is taken stage by stage.

    Raises:
        UserError: as `discretise`.
    """
    if integrator == "rk4":
        x, u = (tuple(v.symbol for v in group) for group in (model.states, model.inputs))
        step = RungeKutta(x, u, model.numeric(), tau)
        if step.operations() > WRITTEN_OUT:
            return step
    return discretise(model, tau, integrator)


def discretise(model: SymbolicModel, tau: float, integrator: str) -> Exprs:
    """The sampled map f, one expression a state over the symbols of states and inputs; parameters are numbers.

    Args:
        model: continuous dynamics.
        tau: sampling time, s.
        integrator: a key of `INTEGRATORS`.

    Raises:
        UserError: unknown integrator, or one that does not fit this plant.
    """
    if integrator not in INTEGRATORS:
        raise UserError(f"no integrator '{integrator}'", remedy=f"Known: {', '.join(INTEGRATORS)}.")
    return INTEGRATORS[integrator](model, model.numeric(), sp.Float(tau))


def explicit_euler(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """x+ = x + h F(x, u): the paper's choice."""
    return tuple(v.symbol + h * f for v, f in zip(model.states, xdot, strict=True))


def semi_implicit_euler(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """Velocities first, positions with the new velocities: PyBullet's own step."""
    if not model.coordinates:
        raise UserError("semi_implicit_euler needs coordinates with velocities", remedy="Use explicit_euler or rk4.")
    rate = {c.position: c.velocity for c in model.coordinates}
    new = {v.name: v.symbol + h * f for v, f in zip(model.states, xdot, strict=True) if v.name not in rate}
    velocities = {symbol(name): new[name] for name in rate.values()}
    moved = {
        v.name: v.symbol + h * f.subs(velocities) for v, f in zip(model.states, xdot, strict=True) if v.name in rate
    }
    return tuple(moved.get(v.name, new.get(v.name)) for v in model.states)


def rk4(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """The classical fourth-order Runge-Kutta step."""
    return rk4_exprs([v.symbol for v in model.states], xdot, h)


def exact_arc(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """The exact solution of a unicycle: an arc of length v h turning by w h (the chord leaves at w h / 2)."""
    wheels = model.wheels
    if wheels is None:
        raise UserError("exact_arc is for a planar wheeled robot", remedy="Declare `plant.wheels` or use rk4.")
    rows = dict(zip(model.state_names, xdot, strict=True))
    heading = symbol(wheels.heading)
    turn = rows[wheels.heading]
    speed = sp.simplify(rows[wheels.x] * sp.cos(heading) + rows[wheels.y] * sp.sin(heading))
    states = {v.symbol for v in model.states}
    slip = sp.simplify(rows[wheels.y] * sp.cos(heading) - rows[wheels.x] * sp.sin(heading))
    if slip != 0 or (speed.free_symbols | turn.free_symbols) & states or len(rows) != 3:
        raise UserError("exact_arc needs x' = v cos(heading), y' = v sin(heading), heading' = w", remedy="Use rk4.")
    chord, bearing = speed * h * sp.sinc(turn * h / 2), heading + turn * h / 2
    new = {
        wheels.x: symbol(wheels.x) + chord * sp.cos(bearing),
        wheels.y: symbol(wheels.y) + chord * sp.sin(bearing),
        wheels.heading: heading + turn * h,
    }
    return tuple(new[name] for name in model.state_names)


INTEGRATORS: Mapping[str, Callable[[SymbolicModel, Exprs, sp.Expr], Exprs]] = {
    "explicit_euler": explicit_euler,
    "semi_implicit_euler": semi_implicit_euler,
    "rk4": rk4,
    "exact_arc": exact_arc,
}


def nominal_paths(
    model: SymbolicModel, integrator: str, tau: float, start: Floats, inputs: Floats, poses: int
) -> tuple[Floats, float]:
    """States after 1/poses, 2/poses, ..., all of tau from one state under each input held.

    Args:
        start: (nx,); inputs: (M, nu).

    Returns:
        (M, poses, nx), and how far the path between two of them may bulge out of the line through them, in state units:
        an eighth of the largest second difference, a tenth more for what second differences miss.
    """
    symbols = [v.symbol for v in (*model.states, *model.inputs)]
    columns = [*start, *inputs.T]
    out = np.empty((len(inputs), poses, len(start)))
    for k in range(poses):
        f = sp.lambdify(symbols, discretise(model, tau * (k + 1) / poses, integrator), "numpy")
        for i, values in enumerate(f(*columns)):
            out[:, k, i] = values
    path = np.concatenate([np.broadcast_to(start, (len(inputs), 1, len(start))), out], axis=1)
    bulge = np.abs(np.diff(path, n=2, axis=1)).max() / 8.0 if poses > 1 else np.abs(np.diff(path, axis=1)).max()
    return out, 1.1 * float(bulge)
