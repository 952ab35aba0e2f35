"""Window simulation: the continuous model over true time stamps, inputs held, delayed and lagged, dry friction exact.

Fourth-order Runge-Kutta between the instants where the input switches; see `stick_slip` for dry friction.
Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float64, int64, njit, void

from simgap.arrays import Floats, Ints
from simgap.diagnosis.simulation.dynamics import INDICES, MATRIX, SLOPE, STEP, VECTOR, function_at
from simgap.diagnosis.simulation.stick_slip import (
    CREEP,
    find_rubbing,
    hold_or_start,
    inner,
    input_at,
    reversed_speed,
    stepped,
    stop_at_release,
    stop_at_reversal,
)

EPS = 1e-12  # s: two instants closer than this are one
_REVERSALS = 8  # between two switches of the input; what turns round more often stays at rest for a step


@inner
def _followed(time: float, k: int, first: int, t: Floats, held: Ints, delay: Floats) -> None:
    """Which sample each input follows at the instant of sample k: the last whose command has arrived (into `held`)."""
    for c in range(held.size):
        held[c] = k
        while held[c] > first and t[held[c]] + delay[c] > time + EPS:
            held[c] -= 1


@inner
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
        int64, int64, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, MATRIX, INDICES, INDICES, INDICES, INDICES,
        INDICES, float64, MATRIX,
    ),
    cache=True, error_model="numpy",
)  # fmt: skip
def simulate(
    slope_at: int, free_at: int, t: Floats, level: Floats, excess: Floats, delay: Floats, lag: Floats,
    theta: Floats, x0: Floats, first: Ints, start: Ints, stop: Ints, offset: Ints, speed: Ints, h_max: float,
    out: Floats,
) -> None:  # fmt: skip
    """Simulate every window from its own initial state.

    Args:
        slope_at, free_at: addresses of the compiled dynamics (`SLOPE`, `STEP`).
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
    slope, free = function_at(SLOPE, slope_at), function_at(STEP, free_at)
    nx, m = x0.shape[1], level.shape[1]
    x, new, u = np.empty(nx), np.empty(nx), np.empty(m)
    pad = (np.empty(2 * nx), np.empty(nx))
    felt = (np.empty(m), np.empty(m), np.empty(m))
    s, held = np.zeros(speed.size), np.zeros(m, dtype=np.int64)
    stuck, active = np.zeros(speed.size, dtype=np.bool_), np.zeros(speed.size, dtype=np.bool_)
    drive = (t, held, level, excess, delay, lag)
    for w in range(start.size):
        time = t[start[w]]
        _followed(time, start[w], first[w], t, held, delay)
        input_at(time, drive, u)
        for i in range(nx):
            x[i] = out[offset[w], i] = x0[w, i]
        rubs = find_rubbing(slope, x, u, theta, s, stuck, active, speed, pad)
        for k in range(start[w] + 1, stop[w]):
            while t[k] - time > EPS:
                end, span, steady, turned = _next_switch(time, k, t, held, delay), h_max, True, 0
                for c in range(m):
                    u[c] = level[held[c], c]
                    if lag[c] > 0.0 and excess[held[c], c] != 0.0:  # it fades: shorter steps
                        steady, span = False, min(span, max(0.5 * lag[c], 0.1 * h_max))
                while end - time > EPS:
                    rests = sticks = False
                    if rubs:
                        for j in range(speed.size):
                            if active[j] and (stuck[j] or abs(x[speed[j]]) <= CREEP):
                                rests = True
                            else:
                                s[j] = 0.0 if not active[j] else 1.0 if x[speed[j]] > 0.0 else -1.0
                        if rests:
                            if not steady:
                                input_at(time, drive, u)
                            if hold_or_start(slope, x, u, theta, s, stuck, active, speed, pad) and steady:
                                break
                            for j in range(speed.size):
                                sticks = sticks or stuck[j]
                    count = max(math.ceil((end - time) / span - 1e-9), 1)
                    h = (end - time) / count
                    if steady and not sticks:
                        at_once = 1 if rubs else count
                        for i in range(nx):
                            new[i] = x[i]
                        free(new, u, u, u, theta, s, h, at_once, pad[0])
                        h *= at_once
                    else:
                        stepped(slope, free, x, time, h, theta, s, stuck, speed, drive, felt, pad, new)
                    if sticks and turned <= _REVERSALS:
                        h = stop_at_release(slope, free, x, time, h, theta, s, stuck, speed, drive, felt, pad, new)
                    j = reversed_speed(x, new, s, stuck, active, speed) if rubs else -1
                    if j >= 0 and (turned > _REVERSALS or abs(x[speed[j]]) <= CREEP):  # it cannot leave rest
                        stuck[j] = True
                        x[speed[j]] = 0.0
                        stepped(slope, free, x, time, h, theta, s, stuck, speed, drive, felt, pad, new)
                    elif j >= 0:
                        h = stop_at_reversal(
                            slope, free, x, time, h, speed[j], theta, s, stuck, speed, drive, felt, pad, new
                        )  # fmt: skip
                        stuck[j] = True
                        turned += 1
                    for i in range(nx):
                        x[i] = new[i]
                    time += max(h, EPS)
                time = end
            time = t[k]
            for i in range(nx):
                out[offset[w] + k - start[w], i] = x[i]
