"""Window simulation: the continuous model over true time stamps, inputs held, delayed and lagged, dry friction exact.

Fourth-order Runge-Kutta between the instants where the input switches. Dry friction enters through one sign s_j for
each coordinate, not through its speed: the step runs with the sign fixed, a change of direction inside it is located,
and at rest s_j is solved for (Filippov's equivalent control), so that a joint sticks exactly while |s_j| <= 1.
Source: Filippov (1988), Differential Equations with Discontinuous Righthand Sides, sec. 4; Hairer, Norsett, Wanner
(1993), Solving Ordinary Differential Equations I, sec. II.1 and II.6 (events).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import boolean, float64, int64, njit, types, void
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_V, _M, _I = float64[::1], float64[:, ::1], int64[::1]
RHS_SIGNATURE = void(_V, _V, _V, _V, _V)  # (x, u, theta, signs, xdot out)
RHS = types.FunctionType(RHS_SIGNATURE)
_EPS = 1e-12  # s: two instants closer than this are one
_CREEP = 1e-14  # a speed below this is rest


@njit(void(RHS, _V, _V, _V, _V, boolean[::1], _I, _V, _V), cache=True)
def _slope(
    rhs: Any, x: Floats, u: Floats, theta: Floats, s: Floats, stuck: Any, speed: Ints, out: Floats, scratch: Floats
) -> None:
    """Xdot with the signs of stuck coordinates solved for (in place); Gauss-Seidel if several stick at once."""
    count = 0
    for j in range(speed.size):
        if stuck[j]:
            count += 1
    for _ in range(1 if count < 2 else 4):
        for j in range(speed.size):
            if stuck[j]:
                s[j] = 0.0
                rhs(x, u, theta, s, scratch)
                free = scratch[speed[j]]
                s[j] = 1.0
                rhs(x, u, theta, s, scratch)
                grip = scratch[speed[j]] - free
                s[j] = -free / grip if grip != 0.0 else 0.0
    rhs(x, u, theta, s, out)
    for j in range(speed.size):
        if stuck[j]:
            out[speed[j]] = 0.0


@njit(cache=True)
def _input_at(
    time: float, t: Floats, u: Floats, held: Ints, level: Floats, excess: Floats, delay: Floats, lag: Floats
) -> None:
    """What the plant feels at an instant; `held[c]` is the sample that input c follows."""
    for c in range(u.size):
        k = held[c]
        u[c] = level[k, c]
        if lag[c] > 0.0:
            u[c] += excess[k, c] * math.exp(-max(time - t[k] - delay[c], 0.0) / lag[c])


@njit(cache=True)
def _rk4(
    rhs: Any, x: Floats, time: float, h: float, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any,
    work: Floats, u: Floats, out: Floats,
) -> None:  # fmt: skip
    """One step of length h from x into out; work has 6 rows."""
    t, held, level, excess, delay, lag = drive
    n = x.size
    k1, k2, k3, k4, at, scratch = work[0], work[1], work[2], work[3], work[4], work[5]
    _input_at(time, t, u, held, level, excess, delay, lag)
    _slope(rhs, x, u, theta, s, stuck, speed, k1, scratch)
    for i in range(n):
        at[i] = x[i] + 0.5 * h * k1[i]
    _input_at(time + 0.5 * h, t, u, held, level, excess, delay, lag)
    _slope(rhs, at, u, theta, s, stuck, speed, k2, scratch)
    for i in range(n):
        at[i] = x[i] + 0.5 * h * k2[i]
    _slope(rhs, at, u, theta, s, stuck, speed, k3, scratch)
    for i in range(n):
        at[i] = x[i] + h * k3[i]
    _input_at(time + h, t, u, held, level, excess, delay, lag)
    _slope(rhs, at, u, theta, s, stuck, speed, k4, scratch)
    for i in range(n):
        out[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@njit(cache=True)
def _direction(
    rhs: Any, x: Floats, u: Floats, theta: Floats, s: Floats, stuck: Any, active: Any, speed: Ints, work: Floats
) -> None:
    """Signs of coordinates in motion; those at rest stick, or start the way the free force pulls."""
    resting = False
    for j in range(speed.size):
        if not active[j]:
            s[j] = 0.0
            stuck[j] = False
        elif abs(x[speed[j]]) > _CREEP and not stuck[j]:
            s[j] = 1.0 if x[speed[j]] > 0.0 else -1.0
        else:
            stuck[j] = True
            resting = True
    if not resting:
        return
    _slope(rhs, x, u, theta, s, stuck, speed, work[0], work[5])
    for j in range(speed.size):
        if stuck[j] and abs(s[j]) > 1.0:
            stuck[j] = False
            s[j] = 1.0 if s[j] > 0.0 else -1.0


@njit(cache=True)
def _reversal(x: Floats, new: Floats, s: Floats, stuck: Any, active: Any, speed: Ints) -> int:
    """The coordinate whose speed left its sign by the largest share of its change; -1 if none did."""
    best, worst = -1, 0.0
    for j in range(speed.size):
        i = speed[j]
        if active[j] and not stuck[j] and new[i] * s[j] < 0.0:
            share = abs(new[i]) / (abs(new[i]) + abs(x[i]) + 1e-300)
            if share > worst:
                best, worst = j, share
    return best


@njit(cache=True)
def _stop_at_reversal(
    rhs: Any, x: Floats, time: float, h: float, i: int, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any,
    work: Floats, u: Floats, new: Floats,
) -> float:  # fmt: skip
    """Shorten a step so that speed i ends at zero (Illinois search); returns its length, the state is in new."""
    a, f_a, b, f_b = 0.0, x[i], 1.0, new[i]
    for _ in range(80):
        if abs(f_b) < 1e-13 or abs(b - a) < 1e-13:
            break
        mid = b - f_b * (b - a) / (f_b - f_a)
        _rk4(rhs, x, time, mid * h, theta, s, stuck, speed, drive, work, u, new)
        f = new[i]
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = mid, f
    new[i] = 0.0
    return b * h


@njit(void(RHS, _V, _V, _V, _V, float64, int64, _V, _V, _V, _V, _V), cache=True)
def _glide(
    rhs: Any, x: Floats, u: Floats, theta: Floats, s: Floats, h: float, steps: int, k1: Floats, k2: Floats, k3: Floats,
    k4: Floats, at: Floats,
) -> None:  # fmt: skip
    """Steps of length h, in place, where the input stands still and nothing sticks: the same formula, no look-outs."""
    n = x.size
    for _ in range(steps):
        rhs(x, u, theta, s, k1)
        for i in range(n):
            at[i] = x[i] + 0.5 * h * k1[i]
        rhs(at, u, theta, s, k2)
        for i in range(n):
            at[i] = x[i] + 0.5 * h * k2[i]
        rhs(at, u, theta, s, k3)
        for i in range(n):
            at[i] = x[i] + h * k3[i]
        rhs(at, u, theta, s, k4)
        for i in range(n):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@njit(cache=True)
def _advance(
    rhs: Any, x: Floats, time: float, end: float, theta: Floats, s: Floats, stuck: Any, active: Any, speed: Ints,
    drive: Any, work: Floats, u: Floats, h_max: float,
) -> None:  # fmt: skip
    """Move x from time to end, between two switches of the input."""
    t, held, level, excess, delay, lag = drive
    new, events, span, still = work[6], 0, h_max, True
    for c in range(u.size):
        if lag[c] > 0.0 and excess[held[c], c] != 0.0:
            span = min(span, max(0.5 * lag[c], 0.1 * h_max))
            still = False
    while end - time > _EPS:
        _input_at(time, t, u, held, level, excess, delay, lag)
        _direction(rhs, x, u, theta, s, stuck, active, speed, work)
        h = (end - time) / math.ceil((end - time) / span - 1e-9)
        if still and not stuck.any():
            new[:] = x
            _glide(rhs, new, u, theta, s, h, 1, work[0], work[1], work[2], work[3], work[4])
        else:
            _rk4(rhs, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        j = _reversal(x, new, s, stuck, active, speed)
        if j >= 0 and (events > 8 or abs(x[speed[j]]) <= _CREEP):  # it cannot leave rest: it stays for this step
            stuck[j] = True
            x[speed[j]] = 0.0
            _rk4(rhs, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        elif j >= 0:
            h = _stop_at_reversal(rhs, x, time, h, speed[j], theta, s, stuck, speed, drive, work, u, new)
            stuck[j] = True
            events += 1
        for i in range(x.size):
            x[i] = new[i]
        time += max(h, _EPS)


@njit(
    void(RHS, _V, _M, _M, _V, _V, _V, _M, _I, _I, _I, _I, _I, float64, _M),
    cache=True,
)
def simulate(
    rhs: Any, t: Floats, level: Floats, excess: Floats, delay: Floats, lag: Floats, theta: Floats, x0: Floats,
    first: Ints, start: Ints, stop: Ints, offset: Ints, speed: Ints, h_max: float, out: Floats,
) -> None:  # fmt: skip
    """Simulate every window from its own initial state.

    Args:
        rhs: compiled dynamics, first-class function of signature `RHS_SIGNATURE`.
        t: (n,) time stamps of all traces one after another, s.
        level: (n, m) inputs after their static maps, held from each stamp until the next.
        excess: (n, m) lagged input minus `level` at each stamp (0 without lag).
        delay: (m,) pure delays, s; lag: (m,) time constants, s.
        theta: parameters of the dynamics.
        x0: (w, nx) states at the first sample of each window.
        first: (w,) first sample of the trace that the window is of; start, stop: (w,) samples [start, stop).
        offset: (w,) first row of the window in `out`.
        speed: index of the velocity of each coordinate, for dry friction.
        h_max: longest step, s.
        out: (sum of lengths, nx), filled with the states at the samples.
    """
    nx, m = x0.shape[1], level.shape[1]
    work, u = np.empty((7, nx)), np.empty(m)
    s, other = np.zeros(speed.size), np.zeros(speed.size)
    stuck, active = np.zeros(speed.size, dtype=np.bool_), np.zeros(speed.size, dtype=np.bool_)
    held = np.zeros(m, dtype=np.int64)
    drive = (t, held, level, excess, delay, lag)
    k1, k2, k3, k4, at = work[0], work[1], work[2], work[3], work[4]
    for w in range(start.size):
        x = x0[w].copy()
        time = t[start[w]]
        for c in range(m):
            held[c] = start[w]
            while held[c] > first[w] and t[held[c]] + delay[c] > time + _EPS:
                held[c] -= 1
        _input_at(time, t, u, held, level, excess, delay, lag)
        for j in range(speed.size):
            s[:], other[:] = 0.0, 0.0
            s[j], other[j] = 1.0, -1.0
            rhs(x, u, theta, s, work[0])
            rhs(x, u, theta, other, work[1])
            active[j] = abs(work[0, speed[j]] - work[1, speed[j]]) > 1e-12
            stuck[j] = False
        smooth = not (active.any() or (lag > 0.0).any())
        s[:] = 0.0
        out[offset[w]] = x
        for k in range(start[w] + 1, stop[w]):
            while t[k] - time > _EPS:
                end = t[k]
                for c in range(m):
                    while held[c] + 1 < k and t[held[c] + 1] + delay[c] <= time + _EPS:
                        held[c] += 1
                    if held[c] + 1 < k and t[held[c] + 1] + delay[c] < end:
                        end = t[held[c] + 1] + delay[c]
                if end - time < _EPS:
                    end = t[k]
                if smooth:
                    for c in range(m):
                        u[c] = level[held[c], c]
                    count = math.ceil((end - time) / h_max - 1e-9)
                    _glide(rhs, x, u, theta, s, (end - time) / count, count, k1, k2, k3, k4, at)
                else:
                    _advance(rhs, x, time, end, theta, s, stuck, active, speed, drive, work, u, h_max)
                time = end
            time = t[k]
            out[offset[w] + k - start[w]] = x
