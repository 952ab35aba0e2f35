"""Window simulation: the continuous model over true time stamps, inputs held, delayed and lagged, dry friction exact.

Fourth-order Runge-Kutta between the instants where the input switches; see `events` for dry friction.
Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float64, int64, njit, void

from simgap.arrays import Floats, Ints
from simgap.diagnosis.simulation.events import CREEP, EPS, advance, any_of, coast, rubbing
from simgap.diagnosis.simulation.handed_over import function_at
from simgap.diagnosis.simulation.runge_kutta import GLIDE, INDICES, RHS, SLOPE, VECTOR, input_at

MATRIX = float64[:, ::1]


@njit(cache=True)
def _followed(time: float, k: int, first: int, t: Floats, held: Ints, delay: Floats) -> None:
    """Which sample each input follows at the instant of sample k: the last whose command has arrived (into `held`)."""
    for c in range(held.size):
        held[c] = k
        while held[c] > first and t[held[c]] + delay[c] > time + EPS:
            held[c] -= 1


@njit(cache=True)
def _next_switch(time: float, k: int, t: Floats, held: Ints, delay: Floats) -> float:
    """The instant before sample k, or that of sample k, up to which all inputs stand still; `held` moves along."""
    end = t[k]
    for c in range(held.size):
        while held[c] + 1 < k and t[held[c] + 1] + delay[c] <= time + EPS:
            held[c] += 1
        if held[c] + 1 < k and t[held[c] + 1] + delay[c] < end:
            end = t[held[c] + 1] + delay[c]
    return end if end - time >= EPS else t[k]


@njit(
    void(
        int64,
        int64,
        int64,
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
    rhs_at: int, slope_at: int, glide_at: int, t: Floats, level: Floats, excess: Floats, delay: Floats, lag: Floats,
    theta: Floats, x0: Floats, first: Ints, start: Ints, stop: Ints, offset: Ints, speed: Ints, h_max: float,
    out: Floats,
) -> None:  # fmt: skip
    """Simulate every window from its own initial state.

    Args:
        rhs_at, slope_at, glide_at: addresses of the compiled dynamics, alone, with what sticks, and of steps under them
            (`RHS`, `SLOPE`, `GLIDE`).
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
    rhs, slope, glide = function_at(RHS, rhs_at), function_at(SLOPE, slope_at), function_at(GLIDE, glide_at)
    nx, m = x0.shape[1], level.shape[1]
    work, x, new = np.empty((6, nx)), np.empty(nx), np.empty(nx)
    u, middle, last = np.empty(m), np.empty(m), np.empty(m)
    pads, s = (np.empty(2 * nx), np.empty(m)), np.zeros(speed.size)
    stuck, active = np.zeros(speed.size, dtype=np.bool_), np.zeros(speed.size, dtype=np.bool_)
    held = np.zeros(m, dtype=np.int64)
    drive = (t, held, level, excess, delay, lag)
    fading = (lag > 0.0).any()
    prompt = not (fading or (delay != 0.0).any())  # inputs switch at the stamps alone
    for w in range(start.size):
        x[:] = x0[w]
        time = t[start[w]]
        _followed(time, start[w], first[w], t, held, delay)
        input_at(time, t, u, held, level, excess, delay, lag)
        rubbing(rhs, x, u, theta, s, speed, work[0], work[1], active)
        stuck[:] = False
        smooth = not (any_of(active) or fading)
        row = offset[w] - start[w]
        out[offset[w]] = x
        for k in range(start[w] + 1, stop[w]):
            while t[k] - time > EPS:
                if prompt:
                    held[:] = k - 1
                    end = t[k]
                else:
                    end = _next_switch(time, k, t, held, delay)
                if smooth:
                    for c in range(m):
                        u[c] = level[held[c], c]
                    count = max(math.ceil((end - time) / h_max - 1e-9), 1)
                    glide(x, u, u, u, theta, s, (end - time) / count, count, pads[0], pads[1])
                else:
                    if not fading:  # as `coast`, which costs more to call than to run
                        for c in range(m):
                            u[c] = level[held[c], c]
                        free = True
                        while free and end - time > EPS:
                            for j in range(speed.size):
                                v = x[speed[j]]
                                if active[j] and (stuck[j] or abs(v) <= CREEP):
                                    free = False
                                    break
                                s[j] = 0.0 if not active[j] else 1.0 if v > 0.0 else -1.0
                            if not free:
                                break
                            h = (end - time) / max(math.ceil((end - time) / h_max - 1e-9), 1)
                            for i in range(nx):
                                new[i] = x[i]
                            glide(new, u, u, u, theta, s, h, 1, pads[0], pads[1])
                            for j in range(speed.size):
                                free = free and not (active[j] and new[speed[j]] * s[j] < 0.0)
                            if free:
                                for i in range(nx):
                                    x[i] = new[i]
                                time += max(h, EPS)
                    else:
                        time = coast(
                            glide, x, new, time, end, theta, s, stuck, active, speed, t, held, level, excess, delay,
                            lag, u, middle, last, pads, h_max,
                        )  # fmt: skip
                    if end - time > EPS:
                        advance(
                            slope, glide, x, new, time, end, theta, s, stuck, active, speed, drive, work, pads, u, h_max
                        )
                time = end
            time = t[k]
            for i in range(nx):
                out[row + k, i] = x[i]
