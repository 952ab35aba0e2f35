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
from numba import float64, njit, void
from numpy.typing import NDArray

from simgap.diagnosis.simulation.runge_kutta import INDICES, RHS, VECTOR, glide, input_at, rk4, slope

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MATRIX = float64[:, ::1]
_EPS = 1e-12  # s: two instants closer than this are one
_CREEP = 1e-14  # a speed below this is rest


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
    slope(rhs, x, u, theta, s, stuck, speed, work[0], work[5])
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
        rk4(rhs, x, time, mid * h, theta, s, stuck, speed, drive, work, u, new)
        f = new[i]
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = mid, f
    new[i] = 0.0
    return b * h


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
        input_at(time, t, u, held, level, excess, delay, lag)
        _direction(rhs, x, u, theta, s, stuck, active, speed, work)
        h = (end - time) / math.ceil((end - time) / span - 1e-9)
        if still and not stuck.any():
            new[:] = x
            glide(rhs, new, u, theta, s, h, 1, work[0], work[1], work[2], work[3], work[4])
        else:
            rk4(rhs, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        j = _reversal(x, new, s, stuck, active, speed)
        if j >= 0 and (events > 8 or abs(x[speed[j]]) <= _CREEP):  # it cannot leave rest: it stays for this step
            stuck[j] = True
            x[speed[j]] = 0.0
            rk4(rhs, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        elif j >= 0:
            h = _stop_at_reversal(rhs, x, time, h, speed[j], theta, s, stuck, speed, drive, work, u, new)
            stuck[j] = True
            events += 1
        for i in range(x.size):
            x[i] = new[i]
        time += max(h, _EPS)


@njit(cache=True)
def _rubbing(
    rhs: Any, x: Floats, u: Floats, theta: Floats, s: Floats, speed: Ints, one: Floats, other: Floats, active: Any
) -> None:
    """Which coordinates the parameters give dry friction: those whose sign matters. The signs s end at 0."""
    for j in range(speed.size):
        s[:] = 0.0
        s[j] = 1.0
        rhs(x, u, theta, s, one)
        s[j] = -1.0
        rhs(x, u, theta, s, other)
        active[j] = abs(one[speed[j]] - other[speed[j]]) > 1e-12
    s[:] = 0.0


@njit(cache=True)
def _followed(time: float, k: int, first: int, t: Floats, held: Ints, delay: Floats) -> None:
    """Which sample each input follows at the instant of sample k: the last whose command has arrived (into `held`)."""
    for c in range(held.size):
        held[c] = k
        while held[c] > first and t[held[c]] + delay[c] > time + _EPS:
            held[c] -= 1


@njit(cache=True)
def _next_switch(time: float, k: int, t: Floats, held: Ints, delay: Floats) -> float:
    """The instant before sample k, or that of sample k, up to which all inputs stand still; `held` moves along."""
    end = t[k]
    for c in range(held.size):
        while held[c] + 1 < k and t[held[c] + 1] + delay[c] <= time + _EPS:
            held[c] += 1
        if held[c] + 1 < k and t[held[c] + 1] + delay[c] < end:
            end = t[held[c] + 1] + delay[c]
    return end if end - time >= _EPS else t[k]


@njit(
    void(
        RHS,
        VECTOR,
        MATRIX,
        MATRIX,
        VECTOR,
        VECTOR,
        VECTOR,
        MATRIX,
        INDICES,
        INDICES,
        INDICES,
        INDICES,
        INDICES,
        float64,
        MATRIX,
    ),
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
    s = np.zeros(speed.size)
    stuck, active = np.zeros(speed.size, dtype=np.bool_), np.zeros(speed.size, dtype=np.bool_)
    held = np.zeros(m, dtype=np.int64)
    drive = (t, held, level, excess, delay, lag)
    k1, k2, k3, k4, at = work[0], work[1], work[2], work[3], work[4]
    for w in range(start.size):
        x = x0[w].copy()
        time = t[start[w]]
        _followed(time, start[w], first[w], t, held, delay)
        input_at(time, t, u, held, level, excess, delay, lag)
        _rubbing(rhs, x, u, theta, s, speed, k1, k2, active)
        stuck[:] = False
        smooth = not (active.any() or (lag > 0.0).any())
        out[offset[w]] = x
        for k in range(start[w] + 1, stop[w]):
            while t[k] - time > _EPS:
                end = _next_switch(time, k, t, held, delay)
                if smooth:
                    for c in range(m):
                        u[c] = level[held[c], c]
                    count = math.ceil((end - time) / h_max - 1e-9)
                    glide(rhs, x, u, theta, s, (end - time) / count, count, k1, k2, k3, k4, at)
                else:
                    _advance(rhs, x, time, end, theta, s, stuck, active, speed, drive, work, u, h_max)
                time = end
            time = t[k]
            out[offset[w] + k - start[w]] = x
