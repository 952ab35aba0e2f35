"""Plants under feedback with several things wrong at once, in small steps that share nothing with the fit.

A stage, a motor, a mass on a spring and a ball on a beam (one coordinate: inertia a = drive f(u) - damping v -
stiffness q - friction), and a cart with a hanging pole. What the plant feels of a command is late, amplified and
shifted, or lags. Dry friction is what a shrinking of the speed leaves (Moreau), and sticks in the rests of the
reference. Positions are read by encoders and controlled by what these read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

Array = np.ndarray
STEPS = 200  # between samples


@dataclass(frozen=True)
class Plant:
    """A plant, how it is controlled and read, and the sizes of what may be hidden.

    Attributes:
        inertia, drive, damping, stiffness: as declared (of a cart-pole none counts: its masses are fixed).
        kp, kd, top: gains of the controller and the largest command; swing: of the reference.
        count: of the encoders; rate: Hz.
        sizes: viscous, dry, gain, bias, delay (samples), lag (samples).
    """

    inertia: float
    drive: float
    damping: float
    stiffness: float
    kp: float
    kd: float
    top: float
    swing: float
    count: float
    rate: float
    sizes: tuple[float, float, float, float, float, float]


PLANTS = {
    "stage": Plant(1.5, 3.937, 18.6, 0.0, 60.0, 0.5, 12.0, 0.1, 4e-5, 100.0, (6.0, 3.0, 0.9, 0.3, 1.0, 1.5)),
    "motor": Plant(2e-3, 0.05, 0.0, 0.0, 1.0, 0.03, 3.0, 1.5, 1.5e-3, 200.0, (4e-4, 0.012, 0.9, 0.06, 1.5, 2.0)),
    "spring": Plant(1.5, 1.0, 0.4, 20.0, 40.0, 4.0, 15.0, 0.08, 2e-5, 200.0, (0.4, 0.3, 0.88, 0.1, 2.0, 2.5)),
    "ball": Plant(0.154, 1.0791, 0.0, 0.0, 1.2, 0.9, 0.3, 0.15, 4e-5, 100.0, (0.05, 0.015, 0.9, 0.01, 1.0, 1.5)),
    "cart_pole": Plant(1.0, 1.0, 0.0, 0.0, 12.0, 4.0, 15.0, 0.25, 5e-5, 200.0, (0.8, 0.5, 0.9, 0.15, 1.5, 2.0)),
}
HIDDEN = ("viscous", "dry", "gain", "bias", "delay", "lag")


def hidden_sizes(name: str, hidden: tuple[str, ...], seed: int) -> dict[str, float]:
    """What the plant is told and its nominal model is not, in SI units; "none" where it is not hidden."""
    plant, rng = PLANTS[name], np.random.default_rng([seed, *name.encode()])
    scatter = dict(zip(HIDDEN, rng.uniform(0.75, 1.3, len(HIDDEN)), strict=True))
    out = {}
    for kind, size in zip(HIDDEN, plant.sizes, strict=True):
        if kind not in hidden:
            continue
        if kind == "gain":
            out[kind] = 1.0 - (1.0 - size) * scatter[kind]
        elif kind in ("delay", "lag"):
            fine = STEPS * plant.rate
            out[kind] = round(size * scatter[kind] / plant.rate * fine) / fine
        else:
            out[kind] = size * scatter[kind]
    return out


@njit
def _felt(u: Array, i: int, j: int, late: int, gain: float, bias: float) -> float:
    """What arrives of the commands at step j of sample i, `late` steps later."""
    at = i * STEPS + j - late
    return gain * (u[at // STEPS] if at >= 0 else 0.0) + bias


@njit
def _one(
    m: float, drive: float, d: float, k: float, dry: float, gain: float, bias: float, late: int, lag: float,
    place: Array, noise: Array, count: float, dt: float, kp: float, kd: float, top: float, sine: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Readings (n, 1) and commands (n,)."""
    n, h = place.size, dt / STEPS
    y, u = np.empty((n, 1)), np.empty(n)
    q, v, z, speed = place[0], 0.0, bias, 0.0
    fade = 1.0 - math.exp(-h / lag) if lag > 0.0 else 1.0
    for i in range(n):
        y[i, 0] = np.round((q + noise[i, 0]) / count) * count
        if i > 0:
            speed += 0.4 * ((y[i, 0] - y[i - 1, 0]) / dt - speed)
        u[i] = min(max(kp * (place[i] - y[i, 0]) - kd * speed, -top), top)
        for j in range(STEPS):
            before, last = z, v
            z += fade * (_felt(u, i, j, late, gain, bias) - z)
            f = 0.5 * (before + z) if lag > 0.0 else z
            half = 0.5 * h * d / m  # damping by the mean speed of the step
            push = h * (drive * (math.sin(f) if sine else f) - k * (q + 0.5 * h * v)) / m
            v, grip = ((1.0 - half) * v + push) / (1.0 + half), h * dry / m / (1.0 + half)
            v = 0.0 if abs(v) <= grip else v - math.copysign(grip, v)
            q += 0.5 * h * (v + last)
    return y, u


@njit
def _cart_pole(
    b: float, dry: float, gain: float, bias: float, late: int, lag: float, place: Array, noise: Array, count: float,
    dt: float, kp: float, kd: float, top: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Readings (n, 2) of cart and pole (0 hangs), commands (n,); friction on the cart."""
    big, small, arm, g = 1.0, 0.3, 0.5, 9.81
    n, h = place.size, dt / STEPS
    y, u = np.empty((n, 2)), np.empty(n)
    x, q, v, w, z, speed, rate = place[0], 0.2, 0.0, 0.0, bias, 0.0, (0.0, 0.0)
    fade = 1.0 - math.exp(-h / lag) if lag > 0.0 else 1.0
    for i in range(n):
        y[i, 0] = np.round((x + noise[i, 0]) / count) * count
        y[i, 1] = np.round((q + noise[i, 1]) / count) * count
        if i > 0:
            speed += 0.4 * ((y[i, 0] - y[i - 1, 0]) / dt - speed)
        u[i] = min(max(kp * (place[i] - y[i, 0]) - kd * speed, -top), top)
        for j in range(STEPS):
            before, v0, w0 = z, v, w
            z += fade * (_felt(u, i, j, late, gain, bias) - z)
            f = 0.5 * (before + z) if lag > 0.0 else z
            mid, v, w = q + 0.5 * h * w, v + 0.5 * h * rate[0], w + 0.5 * h * rate[1]
            s, c = math.sin(mid), math.cos(mid)
            a11, a12, a22 = big + small, small * arm * c, small * arm * arm
            det = a11 * a22 - a12 * a12
            r1, r2 = f - b * v + small * arm * w * w * s, -small * g * arm * s
            v, w = v0 + h * (a22 * r1 - a12 * r2) / det, w0 + h * (a11 * r2 - a12 * r1) / det
            own = a22 / det  # speed of the cart for a unit impulse on it
            push = -min(max(v / own, -h * dry), h * dry)
            v += own * push
            w -= a12 / det * push
            rate = (v - v0) / h, (w - w0) / h
            x += 0.5 * h * (v + v0)
            q += 0.5 * h * (w + w0)
    return y, u


def _place(plant: Plant, rng: np.random.Generator, n: int) -> Array:
    """A reference of a few sines that stands still now and then."""
    hz, phase = rng.uniform(0.15, 2.0, 4), rng.uniform(0.0, 2 * np.pi, 4)
    size = plant.swing * np.array([1.0, 0.6, 0.4, 0.25])
    clock, k = np.empty(n), 0
    now = 0.0
    while k < n:  # the clock of the sines stops in a rest
        move, rest = (int(rng.uniform(a, b) * plant.rate) for a, b in ((1.0, 2.5), (0.3, 0.7)))
        for moving in (True, False):
            for _ in range(move if moving else rest):
                if k < n:
                    now += 1.0 / plant.rate if moving else 0.0
                    clock[k], k = now, k + 1
    return (size * np.sin(2 * np.pi * np.outer(clock, hz) + phase)).sum(axis=1)


def many_run(name: str, hidden: tuple[str, ...], seed: int, seconds: float = 20.0) -> tuple[Array, Array, Array]:
    """One run: stamps (n,), readings (n, k), commands (n, 1)."""
    plant, told = PLANTS[name], hidden_sizes(name, hidden, seed)
    rng, n = np.random.default_rng([seed, 17]), round(seconds * plant.rate)
    place = _place(plant, rng, n)
    noise = 0.4 * plant.count * rng.standard_normal((n, 2))
    path = (
        told.get("gain", 1.0), told.get("bias", 0.0), round(told.get("delay", 0.0) * STEPS * plant.rate),
        told.get("lag", 0.0), place, noise, plant.count, 1.0 / plant.rate, plant.kp, plant.kd, plant.top,
    )  # fmt: skip
    viscous, dry = told.get("viscous", 0.0), told.get("dry", 0.0)
    if name == "cart_pole":
        y, u = _cart_pole(viscous, dry, *path)
    else:
        own = (plant.inertia, plant.drive, plant.damping + viscous, plant.stiffness, dry)
        y, u = _one(*own, *path, name == "ball")
    return np.arange(n) / plant.rate, y, u[:, None].copy()
