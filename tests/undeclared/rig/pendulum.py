"""A driven pendulum with hidden effects, integrated by fine semi-implicit steps with implicit dry friction.

The time stepping is Moreau's (speeds first, dry friction by shrinking the speed towards zero), 10 microseconds a step;
it shares neither code nor method with the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit

STEP = 1e-5
RATE = 200.0
NOMINAL = {"mass": 1.0, "com": 0.5, "inertia": 1.0 / 3.0, "gravity": 9.81}
# order of the numbers that the integrator reads
KEYS = (
    "mass", "com", "inertia", "gravity", "tilt", "b", "F_c", "F_s", "v_s", "c", "k", "k3", "A", "n", "phase", "gain",
    "bias", "width", "limit", "lag", "dahl", "dahl_stiffness", "sine", "sine_hz", "sine_phase", "play",
    "play_stiffness",
)  # fmt: skip


@dataclass(frozen=True)
class Hidden:
    """What the rig was told; only scoring may see it."""

    effects: tuple[tuple[str, str], ...] = ()  # (name, on)
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)  # "name on" -> symbol -> value
    rig: dict[str, float] = field(default_factory=dict)  # numbers of the integrator
    delay: float = 0.0
    offset: float = 0.0
    library: bool = True  # whether the library can express it


@dataclass
class Draft:
    """Hidden effects while they are drawn, one after the other."""

    effects: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    rig: dict[str, float] = field(default_factory=dict)
    delay: float = 0.0
    offset: float = 0.0

    def add(self, name: str, on: str, **values: float) -> None:
        """Note an effect and its parameters for the scoring."""
        self.effects.append((name, on))
        self.parameters[f"{name} {on}"] = values

    def hidden(self) -> Hidden:
        """What the rig is told."""
        return Hidden(tuple(self.effects), self.parameters, self.rig, self.delay, self.offset)


@njit(cache=True)
def _torque(u: float, p: np.ndarray) -> float:
    """Static path of the command: gain, bias, dead zone, saturation."""
    v = p[15] * u + p[16]
    width, limit = p[17], p[18]
    if abs(v) <= width:
        v = 0.0
    else:
        v -= math.copysign(width, v)
    return min(max(v, -limit), limit)


@njit(cache=True)
def integrate(p: np.ndarray, u: np.ndarray, sample: int, delay: int, x0: np.ndarray, step: float) -> np.ndarray:
    """States at the samples: u held for `sample` steps, acting `delay` steps late -> (n, 2)."""
    n = u.size
    out = np.empty((n, 2))
    q, v = x0[0], x0[1]
    inertia, weight, tilt = p[2], p[0] * p[3] * p[1], p[4]
    z, drag = _torque(u[0], p), 0.0
    load_q, load_v = q, v  # the far side of a gear with play
    out[0, 0], out[0, 1] = q, v
    for i in range((n - 1) * sample):
        command = _torque(u[max(i - delay, 0) // sample], p)
        z = command if p[19] <= 0.0 else command + (z - command) * math.exp(-step / p[19])
        force = z - p[5] * v - p[9] * v * abs(v) - p[10] * q - p[11] * q**3
        force += p[12] * math.sin(p[13] * q + p[14])
        force += p[22] * math.sin(2.0 * math.pi * p[23] * i * step + p[24])
        force -= weight * math.sin(q + tilt)
        if p[20] > 0.0:  # Dahl: dF/dt = stiffness v (1 - F/F_c sign v)
            drag += step * p[21] * v * (1.0 - drag / p[20] * math.copysign(1.0, v))
            force -= drag
        if p[25] > 0.0:  # play between a driven rotor and the arm
            gap = load_q - q
            push = 0.0
            if abs(gap) > p[25]:
                push = p[26] * (gap - math.copysign(p[25], gap)) + 0.02 * (load_v - v)
            load_v += step * (z - push) / (0.02 * inertia)
            load_q += step * load_v
            force += push - z
        v += step * force / inertia
        dry = p[6] + (p[7] - p[6]) * math.exp(-((v / p[8]) ** 2)) if p[7] > 0.0 else p[6]
        grip = step * dry / inertia
        v = 0.0 if abs(v) <= grip else v - math.copysign(grip, v)
        q += step * v
        if (i + 1) % sample == 0:
            k = (i + 1) // sample
            out[k, 0], out[k, 1] = q, v
    return out


def multisine(rng: np.random.Generator, n: int, rate: float, top: float = 3.0) -> np.ndarray:
    """Sum of sines from 0.1 to 8 Hz, scaled so that |u| <= top."""
    t = np.arange(n) / rate
    hz = np.geomspace(0.1, 8.0, 24) * rng.uniform(0.95, 1.05, 24)
    sizes, phases = rng.uniform(0.3, 1.0, 24), rng.uniform(0, 2 * np.pi, 24)
    u = np.sum(sizes[:, None] * np.sin(2 * np.pi * hz[:, None] * t + phases[:, None]), axis=0)
    return top * u / np.abs(u).max()


def move(hidden: Hidden, u: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """States at the samples under commands u at RATE -> (n, 2)."""
    numbers = {**dict.fromkeys(KEYS, 0.0), **NOMINAL, "gain": 1.0, "limit": math.inf, "v_s": 1.0, **hidden.rig}
    p = np.array([numbers[k] for k in KEYS])
    return integrate(p, u, round(1.0 / (RATE * STEP)), round(hidden.delay / STEP), x0, STEP)


def record(
    hidden: Hidden, rng: np.random.Generator, sigma: float, velocity: bool, traces: int = 2, seconds: float = 15.0
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Traces (t, y, u) with white noise; the speed channel's noise is ten times the angle's."""
    n = int(seconds * RATE) + 1
    out = []
    for _ in range(traces):
        u = multisine(rng, n, RATE)
        x = move(hidden, u, rng.uniform([-0.5, -0.5], [0.5, 0.5]))
        y = x[:, :1] + hidden.offset + sigma * rng.standard_normal((n, 1))
        if velocity:
            y = np.hstack([y, x[:, 1:] + 10 * sigma * rng.standard_normal((n, 1))])
        out.append((np.arange(n) / RATE, y, u[:, None]))
    return out
