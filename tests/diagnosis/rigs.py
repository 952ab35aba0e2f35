"""Rigs whose recorder is at fault: plants in fine Runge-Kutta steps, and what a logger does to their readings.

Nothing here is shared with the fit. A rig is moved by a sum of sines, held between samples, and read with white noise;
a fault is a function of the true record alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import sympy as sp

from simgap.diagnosis.record.record import Record, Trace
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol
from tests.diagnosis.plants import point_pendulum

STEPS = 4  # Runge-Kutta steps between samples


@dataclass(frozen=True)
class Rig:
    """A plant with one coordinate: q'' = acceleration(q, v, u, hidden), its nominal model and how it is recorded.

    Attributes:
        push: size of the input; sigma: noise of position and velocity.
    """

    name: str
    model: SymbolicModel
    states: tuple[str, str]
    command: str
    joint: str
    acceleration: Callable[[float, float, float, dict[str, float]], float]
    push: float
    sigma: tuple[float, float] = (1e-3, 5e-3)
    rate: float = 200.0
    hidden: dict[str, float] = field(default_factory=dict)


def _pendulum(q: float, v: float, u: float, hidden: dict[str, float]) -> float:
    torque = u * hidden.get("gain", 1.0) - hidden.get("viscous", 0.0) * v - 9.81 * 0.5 * math.sin(q)
    return (torque - hidden.get("coulomb", 0.0) * math.tanh(v / 1e-3)) / 0.3


def _oscillator(q: float, v: float, u: float, hidden: dict[str, float]) -> float:
    force = u * hidden.get("gain", 1.0) - (0.4 + hidden.get("viscous", 0.0)) * v - 20.0 * q
    return (force - hidden.get("coulomb", 0.0) * math.tanh(v / 1e-3)) / 1.5


def oscillator_model() -> SymbolicModel:
    """A mass on a spring with a damper: m v' = u - d v - k q, in SI units."""
    m, d, k = (symbol(n) for n in ("m", "d", "k"))
    return SymbolicModel(
        states=(Variable("q", "m"), Variable("v", "m/s")),
        inputs=(Variable("force", "N"),),
        parameters={"m": Parameter(1.5, "kg"), "d": Parameter(0.4, "N*s/m"), "k": Parameter(20.0, "N/m")},
        xdot=(symbol("v"), (symbol("force") - d * symbol("v") - k * symbol("q")) / m),
        coordinates=(Coordinate("slide", "q", "v", "N"),),
        force_map={"slide": (sp.Integer(0), 1 / m)},
        named_parameters={"mass": NamedParameter("mass", 1.5, "kg", {"m": m * symbol("ratio")})},
    )


def pendulum() -> Rig:
    """A driven pendulum of 1 kg at 0.5 m with an inertia of 0.3 kg m^2."""
    model = point_pendulum(1.0, 0.5, 0.3)
    return Rig("pendulum", model, ("angle", "rate"), "torque", "hinge", _pendulum, 3.0)


def oscillator() -> Rig:
    """A driven mass on a spring."""
    return Rig("mass-spring-damper", oscillator_model(), ("q", "v"), "force", "slide", _oscillator, 4.0)


@dataclass
class Run:
    """One true run: t (n,) s, x (n, 2), u (n,) and a generator for what the recorder adds."""

    t: np.ndarray
    x: np.ndarray
    u: np.ndarray
    rng: np.random.Generator
    sigma: tuple[float, float]

    def read(self) -> np.ndarray:
        """Readings with white noise, (n, 2)."""
        return self.x + np.asarray(self.sigma) * self.rng.standard_normal(self.x.shape)


def true_runs(rig: Rig, seed: int, seconds: float = 10.0, traces: int = 2, **hidden: float) -> list[Run]:
    """Runs of the plant with its hidden numbers."""
    runs = []
    for k in range(traces):
        rng = np.random.default_rng([seed, k, 11])
        t = np.arange(round(seconds * rig.rate)) / rig.rate
        f, phase = rng.uniform(0.1, 4.0, 8), rng.uniform(0, 2 * np.pi, 8)
        u = np.sin(2 * np.pi * f * t[:, None] + phase).sum(axis=1) * rig.push / 3.0
        x = np.empty((len(t), 2))
        q, v = rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5)
        h = 1.0 / rig.rate / STEPS
        for i in range(len(t)):
            x[i] = q, v
            for _ in range(STEPS):
                q, v = _step(rig, q, v, float(u[i]), hidden, h)
        runs.append(Run(t, x, u, rng, rig.sigma))
    return runs


def _step(rig: Rig, q: float, v: float, u: float, hidden: dict[str, float], h: float) -> tuple[float, float]:
    a1 = rig.acceleration(q, v, u, hidden)
    v2 = v + 0.5 * h * a1
    a2 = rig.acceleration(q + 0.5 * h * v, v2, u, hidden)
    v3 = v + 0.5 * h * a2
    a3 = rig.acceleration(q + 0.5 * h * v2, v3, u, hidden)
    v4 = v + h * a3
    a4 = rig.acceleration(q + h * v3, v4, u, hidden)
    return q + h * (v + 2 * v2 + 2 * v3 + v4) / 6, v + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6


def ar1(rng: np.random.Generator, n: int, sigma: float, tau: float, dt: float) -> np.ndarray:
    """Noise with the autocorrelation sigma^2 exp(-|t| / tau), (n,)."""
    a, out = math.exp(-dt / tau), np.empty(n)
    out[0] = sigma * rng.standard_normal()
    for i in range(1, n):
        out[i] = a * out[i - 1] + sigma * math.sqrt(1 - a * a) * rng.standard_normal()
    return out


Recorder = Callable[[Run], tuple[np.ndarray, np.ndarray]]


def clean(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """White noise alone: readings (n, 2), logged input (n,)."""
    return run.read(), run.u


def coloured(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Noise of the same size, correlated over 20 ms."""
    dt = float(run.t[1] - run.t[0])
    noise = [ar1(run.rng, len(run.t), s, 0.02, dt) for s in run.sigma]
    return run.x + np.stack(noise, axis=1), run.u


def hum(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """A line at 50 Hz on the position, five times its noise."""
    y = run.read()
    y[:, 0] += 5 * run.sigma[0] * np.sin(2 * np.pi * 50.2 * run.t + 0.7)
    return y, run.u


def drift(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The position's reading runs away by two noises a second."""
    y = run.read()
    y[:, 0] += 4 * run.sigma[0] * run.t
    return y, run.u


def stale(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """3 % of the rows repeat the readings before them."""
    y = run.read()
    for i in np.flatnonzero(run.rng.random(len(y)) < 0.03):
        y[i] = y[max(i - 1, 0)]
    return y, run.u


def spikes(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Half a per cent of the positions jump by 100 noises."""
    y = run.read()
    hit = run.rng.random(len(y)) < 0.005
    y[hit, 0] += 100 * run.sigma[0] * run.rng.choice([-1.0, 1.0], int(hit.sum()))
    return y, run.u


def late(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The input is logged two samples late."""
    return run.read(), np.concatenate([np.full(2, run.u[0]), run.u[:-2]])


def filtered(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The velocity went through a first-order filter of 20 ms."""
    y, dt = run.read(), float(run.t[1] - run.t[0])
    keep, out = math.exp(-dt / 0.02), run.x[:, 1].copy()
    for i in range(1, len(out)):
        out[i] = keep * out[i - 1] + (1 - keep) * run.x[i, 1]
    y[:, 1] = out + run.sigma[1] * run.rng.standard_normal(len(out))
    return y, run.u


def reversed_input(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The input is logged with the wrong sign."""
    return run.read(), -run.u


def in_degrees(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Positions are logged in degrees where radians are declared (or in units 57.3 times smaller)."""
    y = run.read()
    y[:, 0] *= 180 / np.pi
    return y, run.u


def milli(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The input is logged in thousandths."""
    return run.read(), 1000.0 * run.u


def swapped(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity stand in each other's column."""
    return run.read()[:, ::-1].copy(), run.u


FAULTS: dict[str, tuple[Recorder, str, bool]] = {
    "clean": (clean, "", False),
    "coloured noise": (coloured, "coloured_noise", False),
    "hum": (hum, "hum", False),
    "drift": (drift, "drift", False),
    "stale": (stale, "stale", False),
    "spikes": (spikes, "spikes", False),
    "input late": (late, "late_log", False),
    "velocity filtered": (filtered, "filtered_velocity", True),
    "input reversed": (reversed_input, "wrong_sign", False),
    "input in thousandths": (milli, "wrong_unit", False),
    "position in degrees": (in_degrees, "wrong_unit", True),
    "columns swapped": (swapped, "swapped_columns", True),
}
"""What a recorder does, the fault that is to be found, and whether the velocity is recorded too."""


def record(rig: Rig, fault: str, seed: int, seconds: float = 10.0, **hidden: float) -> Record:
    """A record of the rig through a recorder with that fault."""
    recorder, _, both = FAULTS[fault]
    traces = []
    for k, run in enumerate(true_runs(rig, seed, seconds, **hidden)):
        y, u = recorder(run)
        traces.append(Trace(f"run{k + 1}", run.t, np.ascontiguousarray(y if both else y[:, :1]), u[:, None]))
    return Record(tuple(traces), rig.states if both else rig.states[:1], (rig.command,))
