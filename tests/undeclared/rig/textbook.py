"""Plants of textbooks with something hidden in them, moved by SciPy's Runge-Kutta from their equations of motion.

Nothing here is shared with the fit. A plant gives its rates for the inputs that act and for forces on its coordinates;
what is hidden are forces, what happens to the inputs, a time after which the numbers are others, and pushes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray
GRAVITY = 9.81
_EDGE = 1e-3  # speed over which dry friction turns round


@dataclass(frozen=True)
class Textbook:
    """A plant.

    Attributes:
        states, inputs: their names; measured: which states are read, sigma: with which noise.
        speeds: coordinate -> place of its speed among the states; the position stands in `positions`.
        rates: (x, u, forces on the coordinates, factors of parameters) -> dx/dt.
        start: rng -> x0; command: rng, t (n,) -> waves (n, m); steer: (waves, x) -> inputs of one instant.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    measured: tuple[str, ...]
    sigma: tuple[float, ...]
    positions: Mapping[str, int]
    speeds: Mapping[str, int]
    rates: Callable[[Array, Array, Array, Mapping[str, float]], Array]
    start: Callable[[np.random.Generator], Array]
    command: Callable[[np.random.Generator, Array], Array]
    steer: Callable[[Array, Array], Array] = lambda waves, x: waves
    rate: float = 100.0


@dataclass(frozen=True)
class Hidden:
    """What a plant is told and its nominal model is not.

    Attributes:
        viscous, coulomb, spring: coordinate -> number; gain, bias: input -> number; factors: parameter -> ratio.
        delay: s, of all inputs.
        after: (trace, s) from when on `later` holds in the place of all these.
        pushes: (trace, from, to, coordinate, force) each; more: coordinate -> force at a place and a speed.
    """

    viscous: Mapping[str, float] = field(default_factory=dict)
    coulomb: Mapping[str, float] = field(default_factory=dict)
    spring: Mapping[str, float] = field(default_factory=dict)
    gain: Mapping[str, float] = field(default_factory=dict)
    bias: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    delay: float = 0.0
    after: tuple[int, float] | None = None
    later: Hidden | None = None
    pushes: tuple[tuple[int, float, float, str, float], ...] = ()
    more: Mapping[str, Callable[[float, float], float]] = field(default_factory=dict)

    def at(self, trace: int, t: float) -> Hidden:
        """What holds at an instant."""
        if self.after is None or self.later is None:
            return self
        return self.later if (trace, t) >= self.after else self


Run = tuple[Array, Array, Array]


def runs(
    plant: Textbook, hidden: Hidden, seed: int, *, seconds: float = 10.0, traces: int = 2, sigma: float = 1.0
) -> list[Run]:
    """Runs (t, readings with white noise, inputs as commanded); `sigma` scales the noise."""
    out = []
    for k in range(traces):
        rng = np.random.default_rng([seed, k, 23])
        t = np.arange(round(seconds * plant.rate)) / plant.rate
        x, u = _moved(plant, hidden, k, t, plant.start(rng), plant.command(rng, t))
        read = [plant.states.index(n) for n in plant.measured]
        y = x[:, read] + sigma * np.asarray(plant.sigma) * rng.standard_normal((len(t), len(read)))
        out.append((t, y, u))
    return out


def _moved(plant: Textbook, hidden: Hidden, trace: int, t: Array, x0: Array, waves: Array) -> tuple[Array, Array]:
    x, u = np.empty((len(t), len(x0))), np.empty((len(t), len(plant.inputs)))
    x[0], dt = x0, 1.0 / plant.rate
    for i in range(len(t)):
        u[i] = plant.steer(waves[i], x[i])
        if i + 1 == len(t):
            break
        cuts = [0.0, hidden.delay % dt, dt] if hidden.delay % dt > 1e-9 else [0.0, dt]
        now, whole = x[i], int(hidden.delay / dt + 1e-9)
        for n in range(len(cuts) - 1):
            back = i - whole - (1 if len(cuts) == 3 and n == 0 else 0)
            told = hidden.at(trace, t[i] + cuts[n])
            acting = _acting(plant, told, u[max(back, 0)])
            rates = _rates(plant, told, trace, hidden.pushes)
            span = (t[i] + cuts[n], t[i] + cuts[n + 1])
            now = solve_ivp(rates, span, now, args=(acting,), rtol=1e-7, atol=1e-9).y[:, -1]
        x[i + 1] = now
    return x, u


def _acting(plant: Textbook, told: Hidden, u: Array) -> Array:
    return np.array([told.gain.get(n, 1.0) * v + told.bias.get(n, 0.0) for n, v in zip(plant.inputs, u, strict=True)])


def _rates(plant: Textbook, told: Hidden, trace: int, pushes: tuple) -> Callable[[float, Array, Array], Array]:
    def rates(t: float, x: Array, u: Array) -> Array:
        forces = []
        for c, k in plant.speeds.items():
            v = x[k]
            f = -told.viscous.get(c, 0.0) * v - told.coulomb.get(c, 0.0) * np.tanh(v / _EDGE)
            f -= told.spring.get(c, 0.0) * x[plant.positions[c]] if c in told.spring else 0.0
            f += told.more[c](x[plant.positions[c]], v) if c in told.more else 0.0
            f += sum(p[4] for p in pushes if p[0] == trace and p[3] == c and p[1] <= t < p[2])
            forces.append(f)
        return plant.rates(x, u, np.array(forces), told.factors)

    return rates


def _waves(count: int, size: tuple[float, ...], low: float = 0.1, high: float = 3.0) -> Callable:
    def command(rng: np.random.Generator, t: Array) -> Array:
        out = []
        for top in size:
            hz, phase = rng.uniform(low, high, count), rng.uniform(0.0, 2 * np.pi, count)
            out.append(top / np.sqrt(count) * np.sin(2 * np.pi * np.outer(t, hz) + phase).sum(axis=1))
        return np.stack(out, axis=1)

    return command


def dc_motor() -> Textbook:
    """J w' = K i - friction, L i' = V - R i - K w; shaft angle and current are read."""

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        _, w, i = x
        turn = (0.05 * i + f[0]) / (0.002 * r.get("J", 1.0))
        return np.array([w, turn, (u[0] - r.get("R", 1.0) * i - 0.05 * w) / 0.02])

    return Textbook(
        "dc_motor", ("q", "w", "i"), ("V",), ("q", "i"), (1e-3, 5e-3), {"shaft": 0}, {"shaft": 1}, rates,
        lambda rng: np.array([0.0, rng.uniform(-5, 5), 0.0]), _waves(6, (4.0,)),
    )  # fmt: skip


def oscillator() -> Textbook:
    """m v' = u - d v - k q."""

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        force = u[0] - 0.4 * x[1] - 20.0 * r.get("k", 1.0) * x[0] + f[0]
        return np.array([x[1], force / (1.5 * r.get("m", 1.0))])

    return Textbook(
        "oscillator", ("q", "v"), ("u",), ("q",), (5e-4,), {"slide": 0}, {"slide": 1}, rates,
        lambda rng: rng.uniform(-0.1, 0.1, 2), _waves(6, (3.0,)),
    )  # fmt: skip


def pendulum() -> Textbook:
    """I q'' = u - m g l sin q, 1 kg at 0.5 m with I = 0.3 kg m^2, hanging at 0."""

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        torque = u[0] - GRAVITY * 0.5 * np.sin(x[0]) + f[0]
        return np.array([x[1], torque / (0.3 * r.get("m", 1.0))])

    return Textbook(
        "pendulum", ("angle", "rate"), ("torque",), ("angle",), (1e-3,), {"hinge": 0}, {"hinge": 1}, rates,
        lambda rng: rng.uniform(-0.3, 0.3, 2), _waves(6, (2.0,)),
    )  # fmt: skip


def cart_pole(name: str = "cart_pole", up: bool = False) -> Textbook:
    """A pole on a cart, M(q) a = forces: 1 kg and 0.3 kg at 0.5 m hanging; or as in the URDF, upright at 0, steered."""
    cart, pole, length, inertia = (1.0, 0.1, 1.0, 0.0005) if up else (1.0, 0.3, 0.5, 0.0)
    side = -1.0 if up else 1.0

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        _, q, v, w = x
        m, big = pole * r.get("m", 1.0), cart * r.get("M", 1.0)
        # upright: the pole's centre is at x + l sin q, z = l cos q; hanging: at x + l sin q, z = -l cos q
        mass = np.array([[big + m, m * length * np.cos(q)], [m * length * np.cos(q), m * length**2 + inertia]])
        pull = np.array([m * length * w**2 * np.sin(q), -side * m * GRAVITY * length * np.sin(q)])
        return np.concatenate([[v, w], np.linalg.solve(mass, np.array([u[0], 0.0]) + pull + f)])

    if not up:
        return Textbook(
            name, ("x", "q", "v", "w"), ("u",), ("x", "q"), (5e-4, 5e-4), {"cart": 0, "pole": 1},
            {"cart": 2, "pole": 3}, rates, lambda rng: np.array([0.0, rng.uniform(-0.4, 0.4), 0.0, 0.0]),
            _waves(5, (1.8,), 0.2, 2.0),
        )  # fmt: skip
    gain = np.array([-1.0, -32.0, -2.2, -9.0])  # keeps the pole up, by hand
    return Textbook(
        name, ("x", "a", "v", "w"), ("F",), ("x", "a"), (5e-4, 5e-4), {"rail": 0, "hinge": 1}, {"rail": 2, "hinge": 3},
        rates, lambda rng: np.array([0.0, rng.uniform(-0.05, 0.05), 0.0, 0.0]), _waves(5, (1.0,), 0.2, 2.0),
        lambda wave, x: wave - np.array([gain @ x]),
    )  # fmt: skip


def two_link() -> Textbook:
    """Two hanging rods, both hinges driven: 1.2 kg, 0.8 m and 0.7 kg, 0.6 m, inertias 0.064 and 0.021 kg m^2.

    Factors: `m2` of the mass and the inertia of the second, `c2` of the place of its centre of mass, `i2` of its
    inertia alone; `payload` is a weight at its tip, kg, `armature` what the rotor adds at the elbow, kg m^2.
    """
    m1, m2, l1, c1, l2, i1 = 1.2, 0.7, 0.8, 0.4, 0.6, 0.064

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        q1, q2, v1, v2 = x
        rod, tip, middle = m2 * r.get("m2", 1.0), r.get("payload", 0.0), 0.3 * r.get("c2", 1.0)
        b = rod + tip
        c2 = (rod * middle + tip * l2) / b
        j2 = 0.021 * r.get("m2", 1.0) * r.get("i2", 1.0) + rod * (middle - c2) ** 2 + tip * (l2 - c2) ** 2
        alpha, beta, delta = i1 + m1 * c1**2 + b * l1**2, b * l1 * c2, j2 + b * c2**2
        c, s = np.cos(q2), np.sin(q2)
        rotor = r.get("armature", 0.0)
        mass = np.array([[alpha + delta + 2 * beta * c, delta + beta * c], [delta + beta * c, delta + rotor]])
        turn = np.array([beta * s * (2 * v1 * v2 + v2**2), -beta * s * v1**2])
        low = b * GRAVITY * c2 * np.sin(q1 + q2)
        weight = np.array([(m1 * c1 + b * l1) * GRAVITY * np.sin(q1) + low, low])
        return np.concatenate([[v1, v2], np.linalg.solve(mass, u + f + turn - weight)])

    return Textbook(
        "two_link", ("q1", "q2", "v1", "v2"), ("u1", "u2"), ("q1", "q2"), (5e-4, 5e-4), {"shoulder": 0, "elbow": 1},
        {"shoulder": 2, "elbow": 3}, rates, lambda rng: rng.uniform(-0.4, 0.4, 4), _waves(5, (4.0, 1.2), 0.1, 2.0),
    )  # fmt: skip


def vtol() -> Textbook:
    """m x'' = -T sin a, m y'' = T cos a - m g, I a'' = M; hovering under a cascade of two feedbacks."""

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        m, a = r.get("m", 1.0), x[2]
        return np.array([
            *x[3:], (-u[0] * np.sin(a) + f[0]) / m, (u[0] * np.cos(a) + f[1]) / m - GRAVITY, (u[1] + f[2]) / 0.05,
        ])  # fmt: skip

    def steer(wave: Array, x: Array) -> Array:
        lean = np.clip(0.08 * (x[0] - wave[0]) + 0.16 * x[3], -0.4, 0.4)
        thrust = GRAVITY - 2.0 * (x[1] - wave[1]) - 2.5 * x[4]
        return np.array([thrust, -2.5 * (x[2] - lean) - 0.5 * x[5] + wave[2]])

    places = {"x": 0, "y": 1, "a": 2}
    return Textbook(
        "vtol", ("x", "y", "a", "vx", "vy", "w"), ("T", "M"), ("x", "y", "a"), (1e-3, 1e-3, 5e-4), places,
        {n: k + 3 for n, k in places.items()}, rates, lambda rng: rng.uniform(-0.1, 0.1, 6),
        _waves(4, (1.5, 0.8, 0.3), 0.1, 1.5), steer,
    )  # fmt: skip


def wheeled() -> Textbook:
    """x' = v cos a, y' = v sin a, a' = w: the poses are read."""

    def rates(x: Array, u: Array, f: Array, r: Mapping[str, float]) -> Array:
        return np.array([u[0] * np.cos(x[2]), u[0] * np.sin(x[2]), u[1]])

    def command(rng: np.random.Generator, t: Array) -> Array:
        waves = _waves(4, (0.15, 1.0), 0.05, 1.0)(rng, t)
        return waves + np.array([0.3, rng.choice([-0.3, 0.3])])

    return Textbook(
        "wheeled", ("x", "y", "theta"), ("v", "w"), ("x", "y", "theta"), (2e-3, 2e-3, 4e-3), {}, {}, rates,
        lambda rng: rng.uniform(-1, 1, 3), command, rate=50.0,
    )  # fmt: skip


PLANTS: dict[str, Callable[[], Textbook]] = {
    "dc_motor": dc_motor,
    "oscillator": oscillator,
    "pendulum": pendulum,
    "cart_pole": cart_pole,
    "cart_pole_urdf": lambda: cart_pole("cart_pole_urdf", up=True),
    "two_link": two_link,
    "vtol": vtol,
    "wheeled": wheeled,
}
