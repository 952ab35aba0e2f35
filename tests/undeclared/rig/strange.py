"""Mechanisms that no effect of the library is, in plants of textbooks, moved by SciPy.

Sizes follow the plant: `Scale` holds what a run without them is like. Nothing here is shared with the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tests.undeclared.rig.textbook import Array, Run, Textbook

Rates = tuple[float, tuple[float, ...]]
"""A force on the coordinate, and the rates of the mechanism's own states."""


@dataclass(frozen=True)
class Scale:
    """Root mean squares of a coordinate's motion without a mechanism, its inertia, and the input's largest size.

    `force` is what the mechanism's force should amount to, `share` of the mean force that moves the coordinate.
    """

    q: float
    v: float
    inertia: float
    input: float
    force: float
    share: float


@dataclass(frozen=True)
class Mechanism:
    """force: (t, q, v, own states, input) -> force and rates of its `order` own states; `drive`: what acts of an input.

    `drive` gets (the input, what acted in the sample before, t).
    """

    order: int = 0
    force: Callable[[float, float, float, Array, float], Rates] = lambda t, q, v, z, u: (0.0, ())
    drive: Callable[[float, float, float], float] = lambda u, before, t: u
    through: Callable[[Array], float] | None = None
    """The input as the mechanism's states give it, where it has such."""


def _absorber(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A small mass on a spring rides along: a resonance at 1.5 to 4 Hz."""
    mass, w = s.inertia * s.share, 2 * np.pi * rng.uniform(1.5, 4.0)
    k, c = mass * w**2, 2 * 0.05 * mass * w

    def force(t: float, q: float, v: float, z: Array, u: float) -> Rates:
        f = k * (z[0] - q) + c * (z[1] - v)
        return f, (z[1], -f / mass)

    return Mechanism(2, force)


def _viscoelastic(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A spring in series with a damper: it relaxes within a third to one second."""
    k, tau = s.force / s.q, rng.uniform(0.3, 1.0)
    return Mechanism(1, lambda t, q, v, z, u: (-k * z[0], (v - z[0] / tau,)))


def _rough_guide(s: Scale, rng: np.random.Generator) -> Mechanism:
    """Dry friction that depends on the place."""
    n, phase = rng.uniform(1.0, 2.5) / s.q, rng.uniform(0, 2 * np.pi)
    return Mechanism(
        0, lambda t, q, v, z, u: (-s.force * (1 + 0.8 * np.sin(n * q + phase)) * np.tanh(v / (0.02 * s.v)), ())
    )


def _soft_stop(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A spring that is met from one place on."""
    edge = rng.uniform(0.5, 1.2) * s.q
    return Mechanism(0, lambda t, q, v, z, u: (-4.0 * s.force / s.q * max(q - edge, 0.0), ()))


def _limit_cycle(s: Scale, rng: np.random.Generator) -> Mechanism:
    """Damping that is negative in the middle (van der Pol)."""
    return Mechanism(0, lambda t, q, v, z, u: (s.force * (1 - (q / s.q) ** 2) * v / s.v, ()))


def _square_spring(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A spring whose force grows with the square of the way."""
    return Mechanism(0, lambda t, q, v, z, u: (-s.force * q * abs(q) / s.q**2, ()))


def _hum(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A force at a frequency of its own."""
    w, phase = 2 * np.pi * rng.uniform(0.5, 3.0), rng.uniform(0, 2 * np.pi)
    return Mechanism(0, lambda t, q, v, z, u: (1.4 * s.force * np.sin(w * t + phase), ()))


def _gusts(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A slow force without a pattern."""
    w, phase = 2 * np.pi * rng.uniform(0.05, 1.0, 12), rng.uniform(0, 2 * np.pi, 12)
    return Mechanism(0, lambda t, q, v, z, u: (s.force * np.sqrt(2 / 12) * np.sin(w * t + phase).sum(), ()))


def _warming_drive(s: Scale, rng: np.random.Generator) -> Mechanism:
    """The drive gives less as it gets warm."""
    tau, less = rng.uniform(2.0, 5.0), s.share * 1.5
    return Mechanism(drive=lambda u, before, t: u * (1 - less * (1 - np.exp(-t / tau))))


def _thickening(s: Scale, rng: np.random.Generator) -> Mechanism:
    """Viscous friction that grows threefold in a run."""
    return Mechanism(0, lambda t, q, v, z, u: (-s.force * v / s.v * (0.5 + 0.1 * t), ()))


def _slow_slew(s: Scale, rng: np.random.Generator) -> Mechanism:
    """The drive follows no faster than a rate."""
    rate = s.input * rng.uniform(2.0, 5.0)
    return Mechanism(drive=lambda u, before, t: before + float(np.clip(u - before, -0.01 * rate, 0.01 * rate)))


def _ringing_drive(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A drive of second order that overshoots, at 3 to 6 Hz."""
    w, zeta = 2 * np.pi * rng.uniform(3.0, 6.0), 0.2
    return Mechanism(
        2, lambda t, q, v, z, u: (0.0, (z[1], w**2 * (u - z[0]) - 2 * zeta * w * z[1])), through=lambda z: float(z[0])
    )


def _loose_linkage(s: Scale, rng: np.random.Generator) -> Mechanism:
    """The drive's command is passed on with play."""
    half = 0.5 * s.share * s.input
    return Mechanism(drive=lambda u, before, t: float(np.clip(before, u - half, u + half)))


def _coarse_drive(s: Scale, rng: np.random.Generator) -> Mechanism:
    """The drive knows a few steps only."""
    step = s.share * s.input
    return Mechanism(drive=lambda u, before, t: step * round(u / step))


def _cubic_drag(s: Scale, rng: np.random.Generator) -> Mechanism:
    """A drag that grows with the cube of the speed."""
    return Mechanism(0, lambda t, q, v, z, u: (-0.4 * s.force * (v / s.v) ** 3, ()))


def _one_way_damper(s: Scale, rng: np.random.Generator) -> Mechanism:
    """Viscous friction in one direction alone."""
    return Mechanism(0, lambda t, q, v, z, u: (-1.5 * s.force * max(v, 0.0) / s.v, ()))


MECHANISMS: dict[str, Callable[[Scale, np.random.Generator], Mechanism]] = {
    "absorber": _absorber,
    "viscoelastic": _viscoelastic,
    "rough guide": _rough_guide,
    "soft stop": _soft_stop,
    "limit cycle": _limit_cycle,
    "square spring": _square_spring,
    "hum": _hum,
    "gusts": _gusts,
    "warming drive": _warming_drive,
    "thickening": _thickening,
    "slow slew": _slow_slew,
    "ringing drive": _ringing_drive,
    "loose linkage": _loose_linkage,
    "coarse drive": _coarse_drive,
    "cubic drag": _cubic_drag,
    "one-way damper": _one_way_damper,
}


def strange_runs(plant: Textbook, kind: str, seed: int, gain: float = 1.0, traces: int = 2) -> list[Run]:
    """Runs of 10 s (t, readings, inputs as commanded) under a mechanism; the first input acts `gain` times."""
    still = Mechanism()
    sizes = np.random.default_rng([seed, *kind.encode()])
    share = float(sizes.uniform(0.05, 0.25))
    begun = [_begin(plant, seed, k) for k in range(traces)]
    plain = [_moved(plant, still, gain, *b) for b in begun]
    mechanism = MECHANISMS[kind](_scale(plant, plain, share), sizes)
    out = []
    for k, b in enumerate(begun):
        x, u = _moved(plant, mechanism, gain, *b)
        read = [plant.states.index(n) for n in plant.measured]
        noise = np.random.default_rng([seed, k, 7]).standard_normal((len(x), len(read)))
        out.append((b[0], x[:, read] + np.asarray(plant.sigma) * noise, u))
    return out


def _begin(plant: Textbook, seed: int, trace: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng([seed, trace, 29])
    t = np.arange(round(10.0 * plant.rate)) / plant.rate
    return t, plant.start(rng), plant.command(rng, t)


def _scale(plant: Textbook, runs: list[tuple[Array, Array]], share: float) -> Scale:
    name = next(iter(plant.positions))
    k, speed = plant.positions[name], plant.speeds[name]
    x, u = (np.concatenate([r[j] for r in runs]) for j in (0, 1))
    forces = np.zeros(len(plant.positions))
    unit = np.eye(len(forces))[0]
    ease = plant.rates(x[0], u[0], unit, {})[speed] - plant.rates(x[0], u[0], forces, {})[speed]
    turn = np.array([plant.rates(a, b, forces, {})[speed] for a, b in zip(x[::10], u[::10], strict=True)])
    inertia = 1.0 / ease
    q, v = (float(np.std(x[:, j])) for j in (k, speed))
    force = share * inertia * float(np.sqrt(np.mean(turn**2)))
    return Scale(q, v, float(inertia), float(np.abs(u[:, 0]).max()), force, share)


def _moved(
    plant: Textbook, mechanism: Mechanism, gain: float, t: Array, x0: Array, waves: Array
) -> tuple[Array, Array]:
    n, name = len(x0), next(iter(plant.positions))
    place, speed, count = plant.positions[name], plant.speeds[name], len(plant.positions)
    x, u = np.empty((len(t), n)), np.empty((len(t), len(plant.inputs)))
    now = np.concatenate([x0, np.zeros(mechanism.order)])
    if mechanism.order == 2 and mechanism.through is None:
        now[n] = x0[place]  # what rides along begins where it rests
    acted = 0.0

    def rates(at: float, s: Array, held: Array) -> Array:
        z = s[n:]
        f, dz = mechanism.force(at, s[place], s[speed], z, held[0])
        acting = held if mechanism.through is None else np.array([mechanism.through(z), *held[1:]])
        return np.concatenate([plant.rates(s[:n], acting, np.array([f] + [0.0] * (count - 1)), {}), dz])

    for i in range(len(t)):
        x[i], u[i] = now[:n], plant.steer(waves[i], now[:n])
        acted = mechanism.drive(float(u[i, 0]), acted, t[i])
        held = np.array([gain * acted, *u[i, 1:]])
        if i + 1 < len(t):
            now = solve_ivp(rates, (t[i], t[i + 1]), now, args=(held,), rtol=1e-7, atol=1e-9).y[:, -1]
    return x, u
