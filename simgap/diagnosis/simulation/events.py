"""Steps through dry friction: coasting while nothing turns round, and what happens where something does or rests.

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
from simgap.diagnosis.simulation.runge_kutta import input_at, rk4
from simgap.late import njit

RELEASED = 1e-6  # of a step, or of the grip: an instant as late is that of the release


@njit(cache=True)
def _pull(
    slope: Any, x: Floats, time: float, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any, work: Floats,
    u: Floats,
) -> float:  # fmt: skip
    """By how many grips the force on what sticks exceeds one, the largest; negative while all holds."""
    t, held, level, excess, delay, lag = drive
    input_at(time, t, u, held, level, excess, delay, lag)
    slope(x, u, theta, s, stuck, speed, work[0], work[5])
    most = -1.0
    for j in range(speed.size):
        if stuck[j]:
            most = max(most, abs(s[j]) - 1.0)
    return most


@njit(cache=True)
def stop_at_release(
    slope: Any, x: Floats, time: float, h: float, theta: Floats, s: Floats, stuck: Any, speed: Ints, drive: Any,
    work: Floats, u: Floats, new: Floats,
) -> float:  # fmt: skip
    """Shorten a step so that it ends where what sticks first breaks away; returns its length, the state is in new.

    The end is on the far side, where it is free. A whole step later it would set off with that much less speed.
    """
    f_b = _pull(slope, new, time + h, theta, s, stuck, speed, drive, work, u)
    if f_b <= 0.0:
        return h
    a, f_a, b = 0.0, min(_pull(slope, x, time, theta, s, stuck, speed, drive, work, u), 0.0), 1.0
    side = 0
    for _ in range(40):
        if b - a < RELEASED or f_b < RELEASED:
            break
        mid = min(max(b - f_b * (b - a) / (f_b - f_a), a + 0.01 * (b - a)), b - 0.01 * (b - a))
        rk4(slope, x, time, mid * h, theta, s, stuck, speed, drive, work, u, new)
        f = _pull(slope, new, time + mid * h, theta, s, stuck, speed, drive, work, u)
        if f > 0.0:
            b, f_b = mid, f
            f_a *= 0.5 if side > 0 else 1.0
            side = 1
        else:
            a, f_a = mid, f
            f_b *= 0.5 if side < 0 else 1.0
            side = -1
    rk4(slope, x, time, b * h, theta, s, stuck, speed, drive, work, u, new)
    return b * h


EPS = 1e-12  # s: two instants closer than this are one
CREEP = 1e-14  # a speed below this is rest


@njit(cache=True)
def _direction(
    slope: Any, x: Floats, u: Floats, theta: Floats, s: Floats, stuck: Any, active: Any, speed: Ints, work: Floats
) -> bool:
    """Signs of coordinates in motion; those at rest stick, or start the way the free force pulls.

    Whether nothing at all moves, which lasts while the input stands still.
    """
    resting = False
    for j in range(speed.size):
        if not active[j]:
            s[j] = 0.0
            stuck[j] = False
        elif abs(x[speed[j]]) > CREEP and not stuck[j]:
            s[j] = 1.0 if x[speed[j]] > 0.0 else -1.0
        else:
            stuck[j] = True
            resting = True
    if not resting:
        return False
    rate = work[0]
    slope(x, u, theta, s, stuck, speed, rate, work[5])
    still = True
    for j in range(speed.size):
        if stuck[j] and abs(s[j]) > 1.0:
            stuck[j] = still = False
            s[j] = 1.0 if s[j] > 0.0 else -1.0
    for i in range(rate.size):
        if rate[i] != 0.0:
            still = False
    return still


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
    slope: Any, glide: Any, x: Floats, time: float, h: float, i: int, theta: Floats, s: Floats, stuck: Any, speed: Ints,
    drive: Any, work: Floats, pads: Any, u: Floats, new: Floats, free: bool,
) -> float:  # fmt: skip
    """Shorten a step so that speed i ends at zero (Illinois search); returns its length, the state is in new."""
    a, f_a, b, f_b = 0.0, x[i], 1.0, new[i]
    for _ in range(80):
        if abs(f_b) < 1e-13 or abs(b - a) < 1e-13:
            break
        mid = b - f_b * (b - a) / (f_b - f_a)
        if free:
            new[:] = x
            glide(new, u, u, u, theta, s, mid * h, 1, pads[0], pads[1])
        else:
            rk4(slope, x, time, mid * h, theta, s, stuck, speed, drive, work, u, new)
        f = new[i]
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = mid, f
    new[i] = 0.0
    return b * h


@njit(cache=True)
def _span(still: bool, held: Ints, excess: Floats, lag: Floats, h_max: float) -> float:
    """Longest step, s; shorter while an input fades."""
    span = h_max
    for c in range(lag.size):
        if not still and lag[c] > 0.0 and excess[held[c], c] != 0.0:
            span = min(span, max(0.5 * lag[c], 0.1 * h_max))
    return span


@njit(cache=True)
def _still(held: Ints, excess: Floats, lag: Floats) -> bool:
    """Whether no input fades."""
    still = True
    for c in range(lag.size):
        still = still and not (lag[c] > 0.0 and excess[held[c], c] != 0.0)
    return still


@njit(cache=True)
def coast(
    glide: Any, x: Floats, new: Floats, time: float, end: float, theta: Floats, s: Floats, stuck: Any, active: Any,
    speed: Ints, t: Floats, held: Ints, level: Floats, excess: Floats, delay: Floats, lag: Floats, u: Floats,
    middle: Floats, last: Floats, pads: Any, h_max: float,
) -> float:  # fmt: skip
    """Move x from time towards end, between two switches of the input, until a coordinate with dry friction rests or
    turns round: the time reached."""
    still = _still(held, excess, lag)
    span = _span(still, held, excess, lag, h_max)
    input_at(time, t, u, held, level, excess, delay, lag)
    while end - time > EPS:
        for j in range(speed.size):
            if active[j] and (stuck[j] or abs(x[speed[j]]) <= CREEP):
                return time
            s[j] = 0.0 if not active[j] else 1.0 if x[speed[j]] > 0.0 else -1.0
        h = (end - time) / max(math.ceil((end - time) / span - 1e-9), 1)
        for i in range(x.size):
            new[i] = x[i]
        if still:
            glide(new, u, u, u, theta, s, h, 1, pads[0], pads[1])
        else:
            input_at(time, t, u, held, level, excess, delay, lag)
            input_at(time + 0.5 * h, t, middle, held, level, excess, delay, lag)
            input_at(time + h, t, last, held, level, excess, delay, lag)
            glide(new, u, middle, last, theta, s, h, 1, pads[0], pads[1])
        for j in range(speed.size):
            if active[j] and new[speed[j]] * s[j] < 0.0:
                return time
        for i in range(x.size):
            x[i] = new[i]
        time += max(h, EPS)
    return time


@njit(cache=True)
def advance(
    slope: Any, glide: Any, x: Floats, new: Floats, time: float, end: float, theta: Floats, s: Floats, stuck: Any,
    active: Any, speed: Ints, drive: Any, work: Floats, pads: Any, u: Floats, h_max: float,
) -> None:  # fmt: skip
    """Move x from time to end, between two switches of the input, whatever turns round or sticks."""
    t, held, level, excess, delay, lag = drive
    events, still = 0, _still(held, excess, lag)
    span = _span(still, held, excess, lag, h_max)
    while end - time > EPS:
        input_at(time, t, u, held, level, excess, delay, lag)
        if _direction(slope, x, u, theta, s, stuck, active, speed, work) and still:
            return
        h = (end - time) / max(math.ceil((end - time) / span - 1e-9), 1)
        free = still and not any_of(stuck)
        if free:
            new[:] = x
            glide(new, u, u, u, theta, s, h, 1, pads[0], pads[1])
        else:
            rk4(slope, x, time, h, theta, s, stuck, speed, drive, work, u, new)
            if any_of(stuck) and events <= 8:
                h = stop_at_release(slope, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        j = _reversal(x, new, s, stuck, active, speed)
        if j >= 0 and (events > 8 or abs(x[speed[j]]) <= CREEP):  # it cannot leave rest: it stays for this step
            stuck[j] = True
            x[speed[j]] = 0.0
            rk4(slope, x, time, h, theta, s, stuck, speed, drive, work, u, new)
        elif j >= 0:
            i = speed[j]
            h = _stop_at_reversal(slope, glide, x, time, h, i, theta, s, stuck, speed, drive, work, pads, u, new, free)
            stuck[j] = True
            events += 1
        x[:] = new
        time += max(h, EPS)


@njit(cache=True)
def any_of(flags: Any) -> bool:
    """Whether one of the flags is set."""
    found = False
    for j in range(flags.size):
        found = found or flags[j]
    return found


@njit(cache=True)
def rubbing(
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
