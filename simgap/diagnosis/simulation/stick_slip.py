"""What happens to a step under dry friction: where something turns round, rests, or breaks away.

Dry friction enters through one sign s_j for each coordinate, not through its speed: the step runs with the sign fixed,
a change of direction inside it is located, and at rest s_j is solved for (Filippov's equivalent control), so that a
joint sticks exactly while |s_j| <= 1.
Source: Filippov (1988), Differential Equations with Discontinuous Righthand Sides, sec. 4; Hairer, Norsett, Wanner
(1993), Solving Ordinary Differential Equations I, sec. II.6 (events).
"""

from __future__ import annotations

import math
from typing import Any

from simgap.arrays import Floats, Ints
from simgap.late import njit

RELEASED = 1e-6  # of a step, or of the grip: an instant as late is that of the release
CREEP = 1e-14  # a speed below this is rest

inner = njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""As `njit`, for what compiled code alone calls: it compiles a sixth faster."""


@inner
def input_at(time: float, drive: Any, u: Floats) -> None:
    """What the plant feels at an instant (s), into u (m,); drive: see `simulate`."""
    t, held, level, excess, delay, lag = drive
    for c in range(u.size):
        k = held[c]
        u[c] = level[k, c]
        if lag[c] > 0.0:
            u[c] += excess[k, c] * math.exp(-max(time - t[k] - delay[c], 0.0) / lag[c])


@inner
def stepped(
    slope: Any, free: Any, x: Floats, time: float, h: float, theta: Floats, s: Floats, stuck: Any, speed: Ints,
    drive: Any, felt: Any, pad: Any, new: Floats,
) -> None:  # fmt: skip
    """One step of length h (s) from x (nx,) into new (nx,); slope, free: of `Dynamics`; felt: three (m,) to
    work in."""
    first, middle, last = felt
    input_at(time, drive, first)
    input_at(time + 0.5 * h, drive, middle)
    input_at(time + h, drive, last)
    for i in range(x.size):
        new[i] = x[i]
    sticks = False
    for j in range(speed.size):
        sticks = sticks or stuck[j]
    if not sticks:
        free(new, first, middle, last, theta, s, h, 1, pad[0])
        return
    nx, (at, rate) = x.size, pad
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
def _pull(
    slope: Any, x: Floats, time: float, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any, felt: Any,
    pad: Any,
) -> float:  # fmt: skip
    """By how many grips the force on what sticks exceeds one, the largest; negative while all holds."""
    input_at(time, drive, felt[0])
    slope(x, felt[0], theta, s, stuck, speed, pad[1])
    most = -1.0
    for j in range(speed.size):
        if stuck[j]:
            most = max(most, abs(s[j]) - 1.0)
    return most


@inner
def stop_at_release(
    slope: Any, free: Any, x: Floats, time: float, h: float, theta: Floats, s: Floats, stuck: Any, speed: Ints,
    drive: Any, felt: Any, pad: Any, new: Floats,
) -> float:  # fmt: skip
    """Shorten a step so that it ends where what sticks first breaks away; returns its length, the state is in new.

    The end is on the far side, where it is free. A whole step later it would set off with that much less speed.
    """
    f_b = _pull(slope, new, time + h, theta, s, stuck, speed, drive, felt, pad)
    if f_b <= 0.0:
        return h
    a, f_a, b = 0.0, min(_pull(slope, x, time, theta, s, stuck, speed, drive, felt, pad), 0.0), 1.0
    side, mid = 0, 1.0
    for turn in range(41):
        if turn == 40 or b - a < RELEASED or f_b < RELEASED:
            mid = b
        else:
            mid = min(max(b - f_b * (b - a) / (f_b - f_a), a + 0.01 * (b - a)), b - 0.01 * (b - a))
        stepped(slope, free, x, time, mid * h, theta, s, stuck, speed, drive, felt, pad, new)
        if mid == b:
            break
        f = _pull(slope, new, time + mid * h, theta, s, stuck, speed, drive, felt, pad)
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
    slope: Any, free: Any, x: Floats, time: float, h: float, i: int, theta: Floats, s: Floats, stuck: Any, speed: Ints,
    drive: Any, felt: Any, pad: Any, new: Floats,
) -> float:  # fmt: skip
    """Shorten a step so that speed i ends at zero (Illinois search); returns its length, the state is in new."""
    a, f_a, b, f_b = 0.0, x[i], 1.0, new[i]
    for _ in range(80):
        if abs(f_b) < 1e-13 or abs(b - a) < 1e-13:
            break
        mid = b - f_b * (b - a) / (f_b - f_a)
        stepped(slope, free, x, time, mid * h, theta, s, stuck, speed, drive, felt, pad, new)
        f = new[i]
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = mid, f
    new[i] = 0.0
    return b * h


@inner
def hold_or_start(
    slope: Any, x: Floats, u: Floats, theta: Floats, s: Floats, stuck: Any, active: Any, speed: Ints, pad: Any
) -> bool:
    """What rests sticks, or starts the way the free force pulls; whether then nothing at all moves."""
    for j in range(speed.size):
        if active[j] and abs(x[speed[j]]) <= CREEP:
            stuck[j] = True
    rate = pad[1]
    slope(x, u, theta, s, stuck, speed, rate)
    still = True
    for j in range(speed.size):
        if stuck[j] and abs(s[j]) > 1.0:
            stuck[j] = still = False
            s[j] = 1.0 if s[j] > 0.0 else -1.0
    for i in range(x.size):
        if rate[i] != 0.0:
            still = False
    return still


@inner
def reversed_speed(x: Floats, new: Floats, s: Floats, stuck: Any, active: Any, speed: Ints) -> int:
    """The coordinate whose speed left its sign by the largest share of its change; -1 if none did."""
    best, worst = -1, 0.0
    for j in range(speed.size):
        i = speed[j]
        if active[j] and not stuck[j] and new[i] * s[j] < 0.0:
            share = abs(new[i]) / (abs(new[i]) + abs(x[i]) + 1e-300)
            if share > worst:
                best, worst = j, share
    return best


@inner
def find_rubbing(
    slope: Any, x: Floats, u: Floats, theta: Floats, s: Floats, stuck: Any, active: Any, speed: Ints, pad: Any
) -> bool:
    """Mark the coordinates that the parameters give dry friction, those whose sign matters; whether any. s ends at 0.

    Nothing sticks yet.
    """
    found, rate = False, pad[1]
    for j in range(speed.size):
        stuck[j] = False
        s[j] = 0.0
    for j in range(speed.size):
        s[j] = 1.0
        slope(x, u, theta, s, stuck, speed, rate)
        up = rate[speed[j]]
        s[j] = -1.0
        slope(x, u, theta, s, stuck, speed, rate)
        s[j] = 0.0
        active[j] = abs(up - rate[speed[j]]) > 1e-12
        found = found or active[j]
    return found
