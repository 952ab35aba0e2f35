"""Fourth-order Runge-Kutta steps of the window simulation: inputs that lag, forces that stick solved for.

Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1; Filippov (1988), sec. 4.
"""

from __future__ import annotations

import math
from typing import Any

from numba import boolean, float64, int64, njit, types, void

from simgap.arrays import Floats, Ints

VECTOR, INDICES = float64[::1], int64[::1]
RHS_SIGNATURE = void(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)  # (x, u, theta, signs, xdot out)
RHS = types.FunctionType(RHS_SIGNATURE)
SLOPE_SIGNATURE = void(VECTOR, VECTOR, VECTOR, VECTOR, boolean[::1], INDICES, VECTOR, VECTOR)
"""(x, u, theta, signs, stuck, speed, xdot out, scratch (nx,)): xdot, the signs of stuck coordinates solved for (in
place); Gauss-Seidel if several stick at once. The dynamics are inlined: what rests asks for them three times."""
SLOPE = types.FunctionType(SLOPE_SIGNATURE)
GLIDE_SIGNATURE = void(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, float64, int64, VECTOR, VECTOR)
"""(x, u, u halfway, u at the end, theta, signs, h, steps, scratch (2 nx,), scratch (m,)): steps of length h (s), x in
place, where nothing sticks; the formula of `rk4`, the dynamics inlined, as nearly all steps of a search are these."""
GLIDE = types.FunctionType(GLIDE_SIGNATURE)


@njit(cache=True)
def input_at(
    time: float, t: Floats, u: Floats, held: Ints, level: Floats, excess: Floats, delay: Floats, lag: Floats
) -> None:
    """What the plant feels at an instant (s), into u (m,); `held[c]` is the sample that input c follows: (m,)."""
    for c in range(u.size):
        k = held[c]
        u[c] = level[k, c]
        if lag[c] > 0.0:
            u[c] += excess[k, c] * math.exp(-max(time - t[k] - delay[c], 0.0) / lag[c])


@njit(cache=True)
def rk4(
    slope: Any, x: Floats, time: float, h: float, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any,
    work: Floats, u: Floats, out: Floats,
) -> None:  # fmt: skip
    """One step of length h (s) from x (nx,) into out (nx,); work: (6, nx)."""
    t, held, level, excess, delay, lag = drive
    n = x.size
    k1, k2, k3, k4, at, scratch = work[0], work[1], work[2], work[3], work[4], work[5]
    input_at(time, t, u, held, level, excess, delay, lag)
    slope(x, u, theta, s, stuck, speed, k1, scratch)
    for i in range(n):
        at[i] = x[i] + 0.5 * h * k1[i]
    input_at(time + 0.5 * h, t, u, held, level, excess, delay, lag)
    slope(at, u, theta, s, stuck, speed, k2, scratch)
    for i in range(n):
        at[i] = x[i] + 0.5 * h * k2[i]
    slope(at, u, theta, s, stuck, speed, k3, scratch)
    for i in range(n):
        at[i] = x[i] + h * k3[i]
    input_at(time + h, t, u, held, level, excess, delay, lag)
    slope(at, u, theta, s, stuck, speed, k4, scratch)
    for i in range(n):
        out[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
