"""Window simulation: the continuous model over true time stamps, inputs held, delayed and lagged, dry friction exact.

Fourth-order Runge-Kutta between the instants where the input switches. Dry friction enters through one sign s_j for
each coordinate, not through its speed: the step runs with the sign fixed, a change of direction inside it is located,
and at rest s_j is solved for (Filippov's equivalent control), so that a joint sticks exactly while |s_j| <= 1.
Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1, II.6 (events); Filippov
(1988), Differential Equations with Discontinuous Righthand Sides, sec. 4.

What the compiled functions share goes through them as tuples: `plant` (parameters, index of each coordinate's velocity,
slope and free of `Dynamics`), `grip` (sign of each coordinate, whether it sticks, whether it rubs), `drive` (stamps,
samples that the inputs follow, level, excess, delay, lag) and `work` (room for three (m,), a (2 nx,) and a (nx,)).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import float64, int64, njit, void

from simgap.arrays import Floats, Ints
from simgap.diagnosis.simulation.dynamics import INDICES, MATRIX, SLOPE, STEP, VECTOR, function_at

EPS = 1e-12  # s: two instants closer than this are one
_REVERSALS = 8  # between two switches of the input; what turns round more often stays at rest for a step
RELEASED = 1e-6  # of a step, or of the grip: an instant as late is that of the release
CREEP = 1e-14  # a speed below this is rest

inner = njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""As `njit`, for what compiled code alone calls: it compiles a sixth faster."""


@inner
def input_at(time: float, drive: Any, u: Floats) -> None:
    """What the plant feels at an instant (s), into u (m,); see the module for the tuples."""
    t, held, level, excess, delay, lag = drive
    for c in range(u.size):
        k = held[c]
        u[c] = level[k, c]
        if lag[c] > 0.0:
            u[c] += excess[k, c] * math.exp(-max(time - t[k] - delay[c], 0.0) / lag[c])


@inner
def stepped(plant: Any, grip: Any, drive: Any, work: Any, x: Floats, time: float, h: float, new: Floats) -> None:
    """One step of length h (s) from x (nx,) into new (nx,)."""
    (theta, speed, slope, free), (s, stuck, _), (first, middle, last, at, rate) = plant, grip, work
    input_at(time, drive, first)
    input_at(time + 0.5 * h, drive, middle)
    input_at(time + h, drive, last)
    for i in range(x.size):
        new[i] = x[i]
    if not np.any(stuck):
        free(new, first, middle, last, theta, s, h, 1, at)
        return
    nx = x.size
    for i in range(nx):
        at[i] = x[i]
    for stage in range(4):  # classical Runge-Kutta, any plant's, by its slope
        weight = 2.0 if stage == 1 or stage == 2 else 1.0
        ahead = h if stage == 2 else 0.5 * h
        u = first if stage == 0 else last if stage == 3 else middle
        slope(at, u, theta, s, stuck, speed, rate)
        for i in range(nx):
            at[nx + i] = rate[i] if stage == 0 else at[nx + i] + weight * rate[i]
            at[i] = x[i] + ahead * rate[i]
    for i in range(nx):
        new[i] += h / 6.0 * at[nx + i]


@inner
def _pull(plant: Any, grip: Any, drive: Any, work: Any, x: Floats, time: float) -> float:
    """By how many grips the force on what sticks exceeds one, the largest; negative while all holds."""
    (theta, speed, slope, _), (s, stuck, _), (u, _, _, _, rate) = plant, grip, work
    input_at(time, drive, u)
    slope(x, u, theta, s, stuck, speed, rate)
    most = -1.0
    for j in range(speed.size):
        if stuck[j]:
            most = max(most, abs(s[j]) - 1.0)
    return most


@inner
def stop_at_release(
    plant: Any, grip: Any, drive: Any, work: Any, x: Floats, time: float, h: float, new: Floats
) -> float:
    """Shorten a step so that it ends where what sticks first breaks away; returns its length, the state is in new.

    The end is on the far side, where it is free. A whole step later it would set off with that much less speed.
    """
    f_b = _pull(plant, grip, drive, work, new, time + h)
    if f_b <= 0.0:
        return h
    a, f_a, b = 0.0, min(_pull(plant, grip, drive, work, x, time), 0.0), 1.0
    side, mid = 0, 1.0
    for turn in range(41):
        if turn == 40 or b - a < RELEASED or f_b < RELEASED:
            mid = b
        else:
            mid = min(max(b - f_b * (b - a) / (f_b - f_a), a + 0.01 * (b - a)), b - 0.01 * (b - a))
        stepped(plant, grip, drive, work, x, time, mid * h, new)
        if mid == b:
            break
        f = _pull(plant, grip, drive, work, new, time + mid * h)
        if f > 0.0:
            b, f_b = mid, f
            f_a *= 0.5 if side > 0 else 1.0
            side = 1
        else:
            a, f_a = mid, f
            f_b *= 0.5 if side < 0 else 1.0
            side = -1
    return b * h


@inner
def stop_at_reversal(
    plant: Any, grip: Any, drive: Any, work: Any, x: Floats, time: float, h: float, new: Floats, i: int
) -> float:
    """Shorten a step so that speed i ends at zero (Illinois search); returns its length, the state is in new."""
    a, f_a, b, f_b = 0.0, x[i], 1.0, new[i]
    for _ in range(80):
        if abs(f_b) < 1e-13 or abs(b - a) < 1e-13:
            break
        mid = b - f_b * (b - a) / (f_b - f_a)
        stepped(plant, grip, drive, work, x, time, mid * h, new)
        f = new[i]
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = mid, f
    new[i] = 0.0
    return b * h


@inner
def hold_or_start(plant: Any, grip: Any, work: Any, x: Floats, u: Floats) -> bool:
    """What rests sticks, or starts the way the free force pulls; whether then nothing at all moves."""
    (theta, speed, slope, _), (s, stuck, active), rate = plant, grip, work[4]
    for j in range(speed.size):
        if active[j] and abs(x[speed[j]]) <= CREEP:
            stuck[j] = True
    slope(x, u, theta, s, stuck, speed, rate)
    still = True
    for j in range(speed.size):
        if stuck[j] and abs(s[j]) > 1.0:
            stuck[j] = still = False
            s[j] = 1.0 if s[j] > 0.0 else -1.0
    return still and not np.any(rate)


@inner
def reversed_speed(speed: Ints, grip: Any, x: Floats, new: Floats) -> int:
    """The coordinate whose speed left its sign by the largest share of its change; -1 if none did."""
    best, worst, (s, stuck, active) = -1, 0.0, grip
    for j in range(speed.size):
        i = speed[j]
        if active[j] and not stuck[j] and new[i] * s[j] < 0.0:
            share = abs(new[i]) / (abs(new[i]) + abs(x[i]) + 1e-300)
            if share > worst:
                best, worst = j, share
    return best


@inner
def find_rubbing(plant: Any, grip: Any, work: Any, x: Floats, u: Floats) -> bool:
    """Mark the coordinates that the parameters give dry friction, those whose sign matters; whether any. s ends at 0.

    Nothing sticks yet.
    """
    (theta, speed, slope, _), (s, stuck, active), rate = plant, grip, work[4]
    stuck[:] = False
    s[:] = 0.0
    for j in range(speed.size):
        s[j] = 1.0
        slope(x, u, theta, s, stuck, speed, rate)
        up = rate[speed[j]]
        s[j] = -1.0
        slope(x, u, theta, s, stuck, speed, rate)
        s[j] = 0.0
        active[j] = abs(up - rate[speed[j]]) > 1e-12
    return bool(np.any(active))


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
    cache=True, error_model="numpy", no_cfunc_wrapper=True,
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
    nx, m = x0.shape[1], level.shape[1]
    x, new, u, held = np.empty(nx), np.empty(nx), np.empty(m), np.zeros(m, dtype=np.int64)
    free, at = function_at(STEP, free_at), np.empty(2 * nx)
    s, stuck, active = np.zeros(speed.size), np.zeros(speed.size, np.bool_), np.zeros(speed.size, np.bool_)
    plant, grip = (theta, speed, function_at(SLOPE, slope_at), free), (s, stuck, active)
    drive, work = (t, held, level, excess, delay, lag), (np.empty(m), np.empty(m), np.empty(m), at, np.empty(nx))
    for w in range(start.size):
        time = t[start[w]]
        _followed(time, start[w], first[w], t, held, delay)
        input_at(time, drive, u)
        u[u == 0.0] = 1.0  # friction may grow with the load
        for i in range(nx):
            x[i] = out[offset[w], i] = x0[w, i]
        rubs = find_rubbing(plant, grip, work, x, u)
        input_at(time, drive, u)
        for k in range(start[w] + 1, stop[w]):
            while t[k] - time > EPS:
                end, span, steady, turned = _next_switch(time, k, t, held, delay), h_max, True, 0
                for c in range(m):
                    u[c] = level[held[c], c]
                    if lag[c] > 0.0 and excess[held[c], c] != 0.0:  # it fades: shorter steps
                        steady, span = False, min(span, max(0.5 * lag[c], 0.1 * h_max))
                while end - time > EPS:
                    rests = sticks = False
                    for j in range(speed.size if rubs else 0):
                        if active[j] and (stuck[j] or abs(x[speed[j]]) <= CREEP):
                            rests = True
                        else:
                            s[j] = 0.0 if not active[j] else 1.0 if x[speed[j]] > 0.0 else -1.0
                    if rests:
                        if not steady:
                            input_at(time, drive, u)
                        if hold_or_start(plant, grip, work, x, u) and steady:
                            break
                        sticks = bool(np.any(stuck))
                    count = max(math.ceil((end - time) / span - 1e-9), 1)
                    h = (end - time) / count
                    if steady and not sticks:
                        at_once = 1 if rubs else count
                        for i in range(nx):
                            new[i] = x[i]
                        free(new, u, u, u, theta, s, h, at_once, at)
                        h *= at_once
                    else:
                        stepped(plant, grip, drive, work, x, time, h, new)
                    if sticks and turned <= _REVERSALS:
                        h = stop_at_release(plant, grip, drive, work, x, time, h, new)
                    j = reversed_speed(speed, grip, x, new) if rubs else -1
                    if j >= 0 and (turned > _REVERSALS or abs(x[speed[j]]) <= CREEP):  # it cannot leave rest
                        stuck[j] = True
                        x[speed[j]] = 0.0
                        stepped(plant, grip, drive, work, x, time, h, new)
                    elif j >= 0:
                        h = stop_at_reversal(plant, grip, drive, work, x, time, h, new, speed[j])
                        stuck[j] = True
                        turned += 1
                    for i in range(nx):
                        x[i] = new[i]
                    time += max(h, EPS)
                time = end
            time = t[k]
            for i in range(nx):
                out[offset[w] + k - start[w], i] = x[i]
