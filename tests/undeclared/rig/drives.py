"""A joint with the drive's own effects, in semi-implicit steps of 20 microseconds; it shares nothing with the fit.

Dry friction, that of the load included, shrinks the speed towards zero (Moreau); the bending of asperities is followed
by its solution over a piece of the way: it approaches the side that the motion goes to, exponentially. A motor's
voltage is limited and its back-EMF takes of it what its speed asks for: `stall` and `fall` are the torque-speed line.
A `motor` (its inertia) may stand behind the joint, on a spring of `stiff` with a damper `soft_c`, or between two stops
of that stiffness and damping that are `gap` apart and never pull; its encoder reads the motor if `behind` is 1.
Bristles bear `F_s` at rest and `F_c` far above `v_s`, and are damped by `sigma_1` as they bend (LuGre).
A command acts after `wait` s and a reading shows what was `late` s before, both to the step; such a record begins when
commands from before it no longer act. A `bias` is added to the command, a `push` to the forces on the joint, a `tilt`
to the angle at which its weight pulls.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tests.undeclared.rig.pendulum import multisine

STEP, RATE = 2e-5, 200.0
NULL = {
    "I": 0.0, "F_p": 0.0, "F_m": 0.0, "mu": 0.0, "ratio_p": 1.0, "ratio_m": 1.0,
    "F_c": 0.0, "d": 1.0, "viscous": 0.0, "limit": math.inf, "stall": math.inf, "fall": 0.0,
    "soft": math.inf, "sensor": 1.0, "dead": 0.0,
    "act": 0.0, "sense": 0.0,
    "motor": 0.0, "stiff": 0.0, "soft_c": 0.0, "gap": 0.0, "behind": 0.0,
    "F_s": 0.0, "v_s": 1.0, "sigma_1": 0.0,
    "bias": 0.0, "push": 0.0, "tilt": 0.0, "wait": 0.0, "late": 0.0,
}  # fmt: skip


@njit(cache=True)
def _between(twist: float, rate: float, stiff: float, damping: float, gap: float) -> float:
    """Torque on the link of a motor that is turned against it by a twist."""
    if gap <= 0.0:
        return stiff * twist + damping * rate
    if twist > 0.5 * gap:
        return max(stiff * (twist - 0.5 * gap) + damping * rate, 0.0)
    if twist < -0.5 * gap:
        return min(stiff * (twist + 0.5 * gap) + damping * rate, 0.0)
    return 0.0


@njit(cache=True)
def _move(
    inertia: float,
    weight: float,
    stiffness: float,
    p: np.ndarray,
    u: np.ndarray,
    sample: int,
    x0: np.ndarray,
    step: float,
) -> np.ndarray:
    steps, wait, late = (u.size - 1) * sample, round(p[28] / step), round(p[29] / step)
    shown = np.empty(steps + 1)
    q, v, z = x0[0], x0[1], 0.0
    at, spin = q, v  # a motor behind the joint
    acted, seen = 0.0, q  # an actuator and a sensor that follow with a time constant each
    shown[0] = q
    for i in range(steps):
        command = u[max(i - wait, 0) // sample]
        acted = command + (acted - command) * math.exp(-step / p[15]) if p[15] > 0.0 else command
        command = acted
        drive = (p[4] * command if command > 0.0 else p[5] * command) + p[25]
        drive = math.copysign(max(abs(drive) - p[14], 0.0), drive)
        if p[12] < 1e9:  # iron that saturates
            drive = p[12] * math.tanh(drive / p[12])
        drive = max(-p[9], min(drive, p[9]))
        if drive > p[10] - p[11] * v:
            drive = p[10] - p[11] * v
        elif drive < -p[10] - p[11] * v:
            drive = -p[10] - p[11] * v
        if p[17] > 0.0:
            passed = _between(at - q, spin - v, p[18], p[19], p[20])
            spin += step * (drive - passed) / p[17]
            at += step * spin
            drive = passed
        way = step * v
        side = 1.0 if way > 0.0 else -1.0
        top, old = 1.0, z
        if p[22] > p[6]:  # bristles bear more while they slide slowly
            top = 1.0 + (p[22] / p[6] - 1.0) * math.exp(-((v / p[23]) ** 2))
        z = top * side + (z - top * side) * math.exp(-abs(way) / (top * p[7]))
        rub = p[6] * z + p[24] * p[7] * (z - old) / step
        v += step * (drive + p[26] - weight * math.sin(q + p[27]) - stiffness * q - p[8] * v - rub) / (inertia + p[0])
        grip = step * ((p[1] if v > 0.0 else p[2]) + p[3] * abs(drive)) / (inertia + p[0])
        v = 0.0 if abs(v) <= grip else v - math.copysign(grip, v)
        q += step * v
        read = at if p[21] > 0.0 else q
        seen = read + (seen - read) * math.exp(-step / p[16]) if p[16] > 0.0 else read
        shown[i + 1] = seen
    return np.array([shown[max(k * sample - late, 0)] for k in range(u.size)])


def record(
    inertia: float, weight: float, hidden: dict[str, float], seed: int, *, sigma: float = 1e-3, seconds: float = 12.0,
    top: float = 3.0, traces: int = 2, stiffness: float = 0.0,
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:  # fmt: skip
    """Traces (t, y, u), position alone (times `sensor`), white noise.

    I a = drive + push - weight sin(q + tilt) - stiffness q - friction.
    """
    rng, n, out = np.random.default_rng([seed, 79]), int(seconds * RATE) + 1, []
    told = {**NULL, **hidden}
    p, before = np.array(list(told.values())), math.ceil((told["wait"] + told["late"]) * RATE)
    for _ in range(traces):
        u = multisine(rng, n + before, RATE, top)
        x = _move(inertia, weight, stiffness, p, u, round(1.0 / (RATE * STEP)), rng.uniform(-0.3, 0.3, 2), STEP)
        y = p[13] * x[before:, None] + sigma * rng.standard_normal((n, 1))
        out.append((np.arange(n) / RATE, y, u[before:, None]))
    return out
