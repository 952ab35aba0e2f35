"""When what sticks under dry friction breaks away inside a step, as a command fades in or another joint moves.

Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.6 (events).
"""

from __future__ import annotations

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
