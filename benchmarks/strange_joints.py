"""Records of one joint (30 s at 200 Hz) and of a cart-pole (20 s) that share nothing with the fit.

They are made in semi-implicit steps of 20 microseconds with dry friction as a shrinking of the speed (Moreau). What the
`strange` ones hide is not in the library: friction that depends on the place, a periodic force.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from numba import njit

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from simgap.diagnosis.record.record import Record, Trace  # noqa: E402
from simgap.model.symbolic import (  # noqa: E402
    Coordinate,
    NamedParameter,
    Parameter,
    SymbolicModel,
    Variable,
    symbol,
)

RATE, STEP = 200.0, 2e-5
KEYS = (
    "inertia", "weight", "viscous", "forward", "backward", "rough", "lobes", "bias", "push", "push_hz", "K", "R", "L"
)  # fmt: skip
NULL = dict.fromkeys(KEYS, 0.0) | {"inertia": 1.0}


@njit
def _joint(p: Any, u: Any, sample: int, q: float, v: float, step: float) -> Any:
    """States (n, 3): position, speed, current (0 where the input is a force)."""
    inertia, weight, viscous, forward, backward, rough, lobes, bias, push, hz, k, r, ind = p
    out, i = np.empty((u.size, 3)), 0.0
    out[0] = q, v, i
    for j in range((u.size - 1) * sample):
        drive = u[j // sample]
        if ind > 0.0:
            i += step * (drive - r * i - k * v) / ind
            drive = k * i
        force = drive + bias + push * math.sin(2.0 * math.pi * hz * j * step) - weight * math.sin(q) - viscous * v
        v += step * force / inertia
        grip = step * (forward if v > 0.0 else backward) * (1.0 + rough * math.sin(lobes * q)) / inertia
        v = 0.0 if abs(v) <= grip else v - math.copysign(grip, v)
        q += step * v
        if (j + 1) % sample == 0:
            out[(j + 1) // sample] = q, v, i
    return out


@njit
def _cart_pole(m: float, pole: float, arm: float, b: float, c: float, u: Any, sample: int, step: float) -> Any:
    """States (n, 4) of a cart and a hanging pole, x, q, their rates; viscous friction b on the cart, c on the pole."""
    out = np.zeros((u.size, 4))
    x, q, v, w = 0.0, 0.1, 0.0, 0.0
    out[0] = x, q, v, w
    for j in range((u.size - 1) * sample):
        s, co = math.sin(q), math.cos(q)
        f = u[j // sample] - b * v + pole * arm * w * w * s
        g = -pole * 9.81 * arm * s - c * w
        a, d, e = m + pole, pole * arm * co, pole * arm * arm
        det = a * e - d * d
        v += step * (e * f - d * g) / det
        w += step * (a * g - d * f) / det
        x += step * v
        q += step * w
        if (j + 1) % sample == 0:
            out[(j + 1) // sample] = x, q, v, w
    return out


def commands(rng: np.random.Generator, seconds: float, top: float, rests: bool) -> np.ndarray:
    """A few sines, within every second or third stretch a held small command if there are to be rests."""
    n = int(seconds * RATE) + 1
    t = np.arange(n) / RATE
    hz, phase = rng.uniform(0.2, 4.0, 8), rng.uniform(0.0, 2 * np.pi, 8)
    u = top * np.sin(2 * np.pi * np.outer(t, hz) + phase).mean(axis=1) * 2.0
    k = 0
    while rests and k < n:
        move, rest = (int(rng.uniform(0.4, 1.5) * RATE) for _ in range(2))
        u[k + move : k + move + rest] = rng.uniform(-0.1, 0.1) * top
        k += move + rest
    return u


def joint_model(name: str, inertia: float, weight: float, electric: tuple[float, float, float] | None) -> SymbolicModel:
    """As declared, without friction: I a = u - w sin(q), or driven by a motor with K, R, L."""
    q, v, i, u = (symbol(n) for n in ("q", "v", "i", "u"))
    j, w = symbol("J"), symbol("w")
    states = [Variable("q", "rad" if name != "rail" else "m"), Variable("v", "rad/s" if name != "rail" else "m/s")]
    parameters = {"J": Parameter(inertia, "kg*m^2"), "w": Parameter(weight, "N*m")}
    named = {"inertia": NamedParameter("inertia", inertia, "kg*m^2", {"J": j * symbol("ratio")})}
    pull = u - w * sp.sin(q) if weight else u
    xdot: list[sp.Expr] = [v, pull / j]
    if electric is not None:
        states.append(Variable("i", "A"))
        k, r, ind = (symbol(n) for n in ("K", "R", "L"))
        parameters |= {n: Parameter(x, "1") for n, x in zip(("K", "R", "L"), electric, strict=True)}
        xdot = [v, k * i / j, (u - r * i - k * v) / ind]
    force = [sp.Integer(0), 1 / j, *([sp.Integer(0)] if electric is not None else [])]
    return SymbolicModel(
        states=tuple(states),
        inputs=(Variable("u", "V" if electric is not None else "N*m"),),
        parameters=parameters,
        xdot=tuple(xdot),
        coordinates=(Coordinate("axis", "q", "v", "N" if name == "rail" else "N*m"),),
        force_map={"axis": tuple(force)},
        named_parameters=named,
    )


def cart_pole_model(m: float, pole: float, arm: float) -> SymbolicModel:
    """As declared, without friction."""
    names = {"M": m, "m": pole, "l": arm, "g": 9.81}
    big, small, lever, g = (symbol(n) for n in names)
    q, v, w, u = (symbol(n) for n in ("q", "v", "w", "u"))
    mass = sp.Matrix([[big + small, small * lever * sp.cos(q)], [small * lever * sp.cos(q), small * lever**2]])
    inverse = sp.simplify(mass.inv())
    rest = sp.Matrix([u + small * lever * w**2 * sp.sin(q), -small * g * lever * sp.sin(q)])
    rates = inverse * rest
    return SymbolicModel(
        states=(Variable("x", "m"), Variable("q", "rad"), Variable("v", "m/s"), Variable("w", "rad/s")),
        inputs=(Variable("u", "N"),),
        parameters={n: Parameter(value, "1") for n, value in names.items()},
        xdot=(v, w, rates[0], rates[1]),
        coordinates=(Coordinate("cart", "x", "v", "N"), Coordinate("pole", "q", "w")),
        force_map={
            "cart": (sp.Integer(0), sp.Integer(0), inverse[0, 0], inverse[1, 0]),
            "pole": (sp.Integer(0), sp.Integer(0), inverse[0, 1], inverse[1, 1]),
        },
        named_parameters={
            "cart.mass": NamedParameter("cart.mass", m, "kg", {"M": big * symbol("ratio")}),
            "pole.mass": NamedParameter("pole.mass", pole, "kg", {"m": small * symbol("ratio")}),
        },
    )


@dataclass(frozen=True)
class Bench:
    """One record: the plant as declared, what it hides, how it is driven and read."""

    plant: str
    hidden: dict[str, float]
    top: float
    seed: int
    rests: bool = False
    seconds: float = 30.0
    noise: float = 2e-4
    count: float = 0.0  # a count of the encoder
    inertia: float = 0.25
    weight: float = 0.0
    electric: tuple[float, float, float] | None = None

    def made(self) -> tuple[SymbolicModel, Record]:
        """The model as declared, and the record."""
        rng = np.random.default_rng([self.seed, 81])
        u = commands(rng, self.seconds, self.top, self.rests)
        sample, t = round(1.0 / (RATE * STEP)), np.arange(u.size) / RATE
        if self.plant == "cart-pole":
            model = cart_pole_model(1.0, 0.2, 0.5)
            x = _cart_pole(1.0, 0.2, 0.5, self.hidden["cart"], self.hidden["pole"], u, sample, STEP)
            measured, y = ("x", "q"), x[:, :2] + self.noise * rng.standard_normal((u.size, 2))
        else:
            model = joint_model(self.plant, self.inertia, self.weight, self.electric)
            k, r, ind = self.electric or (0.0, 0.0, 0.0)
            own = {"inertia": self.inertia, "weight": self.weight, "K": k, "R": r, "L": ind}
            p = np.array(list((NULL | own | self.hidden).values()))
            x = _joint(p, u, sample, *rng.uniform(-0.2, 0.2, 2), STEP)
            measured, y = ("q",), x[:, :1] + self.noise * rng.standard_normal((u.size, 1))
            if self.electric is not None:
                measured, y = ("q", "i"), np.hstack([y, x[:, 2:] + 5e-3 * rng.standard_normal((u.size, 1))])
        if self.count:
            y[:, 0] = np.round(y[:, 0] / self.count) * self.count
        return model, Record((Trace("run", t, y, u[:, None]),), measured, ("u",))


TURN = 2 * math.pi / 4096
MOTOR = {"inertia": 2e-3, "electric": (0.1, 1.0, 5e-3)}
ROUGH = {"forward": 0.06, "backward": 0.06, "rough": 0.6, "lobes": 3.0}
BENCHES: dict[str, Bench] = {
    "clean pendulum": Bench("pendulum", {}, 3.0, 1, weight=1.5),
    "motor": Bench(
        "motor", {"viscous": 1e-3, "forward": 0.02, "backward": 0.02}, 6.0, 2, noise=2e-4, count=TURN, **MOTOR
    ),
    "strange motor": Bench(
        "motor", {"viscous": 1e-3, **ROUGH, "forward": 0.02, "backward": 0.02}, 6.0, 3, noise=2e-4, count=TURN, **MOTOR
    ),
    "strange pendulum with rests": Bench("pendulum", ROUGH, 3.0, 4, rests=True, weight=1.5),
    "pendulum, pushed": Bench("pendulum", {"viscous": 0.05, "push": 0.1, "push_hz": 1.3}, 3.0, 5, weight=1.5),
    "strange rail": Bench(
        "rail", {"forward": 0.5, "backward": 0.5, "bias": 0.3, "push": 0.2, "push_hz": 2.1}, 4.0, 6, rests=True,
        inertia=2.0, noise=1e-5, count=2e-5,
    ),
    "cart-pole": Bench("cart-pole", {"cart": 0.5, "pole": 0.01}, 4.0, 7, seconds=20.0),
}  # fmt: skip
