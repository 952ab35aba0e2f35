"""A wheeled robot on the plane with hidden effects, moved in steps of a millisecond by chords of arcs."""

from __future__ import annotations

import numpy as np
from numba import njit

STEP = 1e-3
RATE = 50.0
TRACK = 0.23
NULL = {
    "speed_gain": 1.0, "turn_gain": 1.0, "speed_bias": 0.0, "turn_bias": 0.0, "right_wheel": 1.0, "slip": 0.0,
    "speed_delay": 0.0, "turn_delay": 0.0, "speed_lag": 0.0, "turn_lag": 0.0, "heading_offset": 0.0, "leak": 0.0,
    "rolling": 0.0,
}  # fmt: skip


@njit(cache=True)
def _eased(told: float, resisted: float) -> float:
    """Where a speed loop of gain 1 settles against a dry resistance: the force that is asked for less what resists."""
    if told > resisted:
        return told - resisted
    return told + resisted if told < -resisted else 0.0


@njit(cache=True)
def _drive(p: np.ndarray, u: np.ndarray, sample: int, late: np.ndarray, x0: np.ndarray, step: float) -> np.ndarray:
    n = u.shape[0]
    out = np.empty((n, 3))
    x, y, heading = x0
    z = u[0].copy()
    out[0] = x0
    for i in range((n - 1) * sample):
        for j in range(2):  # a gain and a bias, then the motor's lag
            drive = p[j] * u[max(i - late[j], 0) // sample, j] + p[2 + j]
            z[j] = drive + (z[j] - drive) * np.exp(-step / p[8 + j]) if p[8 + j] > 0.0 else drive
        wheel = p[4] * (1.0 - p[6] * i * step)  # a leaking tyre shrinks
        right, left = wheel * _eased(z[0] + 0.5 * p[7] * z[1], p[10]), _eased(z[0] - 0.5 * p[7] * z[1], p[10])
        forward, turning = 0.5 * (right + left), (right - left) / p[7]
        middle = heading + 0.5 * step * turning
        sideways = p[5] * forward
        x += step * (forward * np.cos(middle) - sideways * np.sin(middle))
        y += step * (forward * np.sin(middle) + sideways * np.cos(middle))
        heading += step * turning
        if (i + 1) % sample == 0:
            out[(i + 1) // sample] = np.array([x, y, heading])
    return out


def record(
    hidden: dict[str, float], rng: np.random.Generator, heading: bool, seconds: float = 30.0, traces: int = 2
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Traces (t, poses, commands): noise of 2 mm and 5 mrad, commands of at most .22 m/s and 1.4 rad/s at 50 Hz."""
    h = {**NULL, **hidden}
    keys = ("speed_gain", "turn_gain", "speed_bias", "turn_bias", "right_wheel", "slip", "leak")
    p = np.array([*(h[k] for k in keys), TRACK, h["speed_lag"], h["turn_lag"], h["rolling"]])
    late = np.array([round(h["speed_delay"] / STEP), round(h["turn_delay"] / STEP)])
    sample, n = round(1.0 / (RATE * STEP)), int(seconds * RATE) + 1
    t, out = np.arange(n) / RATE, []
    for _ in range(traces):
        waves = np.sin(2 * np.pi * np.outer(t, rng.uniform(0.05, 1.5, 8)) + rng.uniform(0, 6.3, 8))
        turning = rng.uniform(0.2, 0.4) * rng.choice([-1.0, 1.0])  # a robot that drives in rounds
        u = np.stack([0.12 + 0.1 * waves[:, :4].mean(axis=1), turning + waves[:, 4:].mean(axis=1)], axis=1)
        x = _drive(p, u, sample, late, rng.uniform(-1, 1, 3), STEP)
        y = x + np.array([0.0, 0.0, h["heading_offset"]]) + rng.normal(size=(n, 3)) * np.array([2e-3, 2e-3, 5e-3])
        out.append((t, y if heading else y[:, :2], u))
    return out
