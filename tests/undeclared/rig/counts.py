"""Plants with dry friction whose positions are read by encoders, in small steps that share nothing with the fit.

One coordinate each: inertia * a = drive * u - damping * v - stiffness * q - friction (a ball: drive * sin u). Dry
friction is what a shrinking of the speed leaves (Moreau); the encoder rounds the position, with some white noise on it,
to whole counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

Array = np.ndarray
_STEPS = 100  # between samples


@dataclass(frozen=True)
class Counted:
    """A plant, how it is driven and how it is read.

    Attributes:
        inertia, drive, damping, stiffness: as declared; viscous, dry: sizes of what may be hidden, scattered by seeds.
        top: largest command; noise: white, before the rounding; rate: Hz.
        gains: position and speed gains of a controller that reads the encoder; 0 where commands are open loop.
    """

    name: str
    inertia: float
    drive: float
    damping: float
    stiffness: float
    viscous: float
    dry: float
    top: float
    noise: float
    rate: float = 100.0
    gains: tuple[float, float] = (0.0, 0.0)
    swing: float = 0.0


BALL = Counted("ball", 1.4 * 0.11, 0.11 * 9.81, 0.0, 0.0, 0.05, 0.015, 0.25, 2e-5, gains=(1.2, 0.9), swing=0.15)
MOTOR = Counted("motor", 2e-3, 0.05, 0.0, 0.0, 4e-4, 0.012, 1.2, 2e-4)
SPRING = Counted("spring", 1.5, 1.0, 0.4, 20.0, 0.3, 0.3, 4.0, 2e-4)
PLANTS = {p.name: p for p in (BALL, MOTOR, SPRING)}
HIDDEN = ("nothing", "viscous", "dry", "both")


@njit
def _moved(
    m: float, drive: float, b: float, k: float, dry: float, q: float, waves: Array, noise: Array, count: float,
    dt: float, steps: int, kp: float, kd: float, top: float, sine: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Readings (n,) and commands (n,)."""
    n = waves.size
    y, u = np.empty(n), np.empty(n)
    v, last, h, speed = 0.0, 0.0, dt / steps, 0.0
    for i in range(n):
        read = q + noise[i]
        y[i] = np.round(read / count) * count
        if kp > 0.0:
            if i > 0:
                speed += 0.3 * ((y[i] - y[i - 1]) / dt - speed)
            u[i] = min(max(kp * (waves[i] - y[i]) - kd * speed, -top), top)
        else:
            u[i] = waves[i]
        push = drive * (np.sin(u[i]) if sine else u[i])
        for _ in range(steps):
            v += h * (push - b * v - k * (q + 0.5 * h * v)) / m
            grip = h * dry / m
            v = 0.0 if abs(v) <= grip else v - grip * np.sign(v)
            q += 0.5 * h * (v + last)  # no half step late
            last = v
    return y, u


def _waves(plant: Counted, rng: np.random.Generator, t: Array) -> Array:
    """Sines with rests between (open loop), or places to go to (steps and a sine)."""
    if plant.gains[0] > 0.0:
        place, k = np.zeros(len(t)), 0
        while k < len(t):
            long = int(rng.uniform(1.0, 2.5) * plant.rate)
            place[k : k + long] = rng.uniform(-plant.swing, plant.swing)
            k += long
        return place + 0.3 * plant.swing * np.sin(2 * np.pi * rng.uniform(0.3, 0.8) * t + rng.uniform(0, 6))
    hz, phase = rng.uniform(0.1, 2.5, 6), rng.uniform(0.0, 2 * np.pi, 6)
    u = plant.top / np.sqrt(6) * np.sin(2 * np.pi * np.outer(t, hz) + phase).sum(axis=1)
    k = 0
    while k < len(t):
        move, rest = (int(rng.uniform(0.5, 1.5) * plant.rate) for _ in range(2))
        u[k + move : k + move + rest] = rng.uniform(-0.1, 0.1) * plant.top
        k += move + rest
    return u


def hidden_sizes(plant: Counted, hidden: str, seed: int) -> Mapping[str, float]:
    """What the plant is told and its nominal model is not: viscous, dry."""
    scatter = np.random.default_rng([seed, *plant.name.encode(), *hidden.encode()]).uniform(0.7, 1.4, 2)
    return {
        "viscous": plant.viscous * scatter[0] if hidden in ("viscous", "both") else 0.0,
        "dry": plant.dry * scatter[1] if hidden in ("dry", "both") else 0.0,
    }


def counted_runs(
    plant: Counted, hidden: str, count: float, seed: int, seconds: float = 10.0, traces: int = 2, rate: float = 0.0
) -> list[tuple[Array, Array, Array]]:
    """Runs (t, readings (n, 1), commands (n, 1)) by an encoder with steps of `count`; rate: Hz, 0: the plant's own."""
    told, out = hidden_sizes(plant, hidden, seed), []
    plant = replace(plant, rate=rate) if rate else plant
    for k in range(traces):
        rng = np.random.default_rng([seed, k, 71])
        t = np.arange(round(seconds * plant.rate)) / plant.rate
        y, u = _moved(
            plant.inertia, plant.drive, plant.damping + told["viscous"], plant.stiffness, told["dry"],
            0.3 * plant.swing * rng.uniform(-1, 1), _waves(plant, rng, t), plant.noise * rng.standard_normal(len(t)),
            count, 1.0 / plant.rate, _STEPS, *plant.gains, plant.top, plant.name == "ball",
        )  # fmt: skip
        out.append((t, y[:, None].copy(), u[:, None].copy()))
    return out
