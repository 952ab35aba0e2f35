"""Records with rests: a drive on a rail, solved in closed form between events, and a pendulum in fine steps.

Under a held force the drive m dv/dt = f - b v - F_c sign(v) slides by a known function of time; the instant at which it
stops is known as well, and it sticks exactly while |f| <= F_c. Nothing here is shared with the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.undeclared.rig import pendulum

RATE = 200.0


@dataclass(frozen=True)
class Drive:
    """A mass on a rail: kg, N, N s/m, N, s; the command acts `late` seconds after its sample."""

    mass: float = 2.0
    friction: float = 0.0
    viscous: float = 0.0
    bias: float = 0.0
    gain: float = 1.0
    late: int = 0  # samples


def _slide(q: float, v: float, f: float, drag: float, mass: float, h: float) -> tuple[float, float]:
    """Position and speed after h seconds under a constant force f - drag v."""
    if drag == 0.0:
        return q + v * h + 0.5 * f / mass * h * h, v + f / mass * h
    c, end = drag / mass, f / drag
    fade = math.exp(-c * h)
    return q + end * h + (v - end) * (1.0 - fade) / c, end + (v - end) * fade


def _until_rest(v: float, f: float, drag: float, mass: float) -> float:
    """Seconds until a sliding mass stops; infinite if it does not."""
    if f * v >= 0.0:
        return math.inf
    if drag == 0.0:
        return -v * mass / f
    return math.log1p(-v * drag / f) * mass / drag


def motion(p: Drive, t: np.ndarray, force: np.ndarray, q: float, v: float) -> np.ndarray:
    """States at the stamps, (n, 2), under forces held from each stamp until the next, exactly."""
    out = np.empty((t.size, 2))
    out[0] = q, v
    for k in range(t.size - 1):
        f, left = p.gain * force[k] + p.bias, t[k + 1] - t[k]
        while left > 0.0:
            if v == 0.0 and abs(f) <= p.friction:
                break
            side = math.copysign(1.0, v if v != 0.0 else f)
            net = f - side * p.friction
            stop = _until_rest(v, net, p.viscous, p.mass)
            if stop <= left:
                q, _ = _slide(q, v, net, p.viscous, p.mass, stop)
                v, left = 0.0, left - stop
            else:
                q, v = _slide(q, v, net, p.viscous, p.mass, left)
                left = 0.0
        out[k + 1] = q, v
    return out


def commands(rng: np.random.Generator, n: int, size: float) -> np.ndarray:
    """Stretches of a few sines up to `size`, and rests under a small held force, .3 to 1.2 s each."""
    u, k, moving = np.zeros(n), 0, bool(rng.integers(2))
    while k < n:
        m = min(int(rng.uniform(0.3, 1.2) * RATE), n - k)
        t = np.arange(m) / RATE
        if moving:
            hz, phase = rng.uniform(0.8, 6.0, 4), rng.uniform(0.0, 2 * np.pi, 4)
            u[k : k + m] = size * np.sin(2 * np.pi * np.outer(t, hz) + phase).mean(axis=1) * 1.6
        else:
            u[k : k + m] = rng.uniform(-0.1, 0.1) * size
        k, moving = k + m, not moving
    return u


def read(rng: np.random.Generator, q: np.ndarray, noise: float, step: float) -> np.ndarray:
    """An encoder: white noise, then counts of `step`."""
    return np.round((q + noise * rng.standard_normal(q.shape)) / step) * step


def drive_record(
    p: Drive, seed: int, *, seconds: float = 15.0, traces: int = 2, size: float = 4.0, noise: float = 1e-5,
    step: float = 1e-5, moving: bool = False,
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:  # fmt: skip
    """Traces (t, y, u); a late drive feels commands from before its first sample, at rest only if not `moving`."""
    rng, n = np.random.default_rng([seed, 77]), int(seconds * RATE) + 1
    t, out = np.arange(n) / RATE, []
    for _ in range(traces):
        before = 400 if moving else 0
        u = commands(rng, before + n + p.late, size)
        x = motion(p, np.arange(before + n) / RATE, u[: before + n], 0.0, 0.0)[before:]
        out.append((t, read(rng, x[:, :1], noise, step), u[p.late + before :, None]))
    return out


def pendulum_record(
    friction: float, seed: int, *, seconds: float = 15.0, traces: int = 2, noise: float = 2e-4, step: float = 2e-4
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Traces of a pendulum that sticks between pushes, angle alone."""
    rng, n = np.random.default_rng([seed, 78]), int(seconds * RATE) + 1
    numbers = {**dict.fromkeys(pendulum.KEYS, 0.0), **pendulum.NOMINAL, "gain": 1.0, "limit": math.inf, "v_s": 1.0}
    p = np.array([{**numbers, "F_c": friction}[k] for k in pendulum.KEYS])
    out = []
    for _ in range(traces):
        u = commands(rng, n, 3.0)
        start = np.array([rng.uniform(-0.05, 0.05), 0.0])
        x = pendulum.integrate(p, u, round(1.0 / (RATE * pendulum.STEP)), 0, start, pendulum.STEP)
        out.append((np.arange(n) / RATE, read(rng, x[:, :1], noise, step), u[:, None]))
    return out
