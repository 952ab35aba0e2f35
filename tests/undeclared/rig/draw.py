"""Effects, sizes and signs drawn at random from the reference set."""

from __future__ import annotations

import numpy as np

from tests.undeclared.rig.pendulum import NOMINAL, RATE, Hidden

SINGLES = (
    "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag", "input_gain", "mass", "length",
    "input_bias", "input_delay", "input_lag", "input_dead_zone", "spring", "cubic_spring", "gravity_tilt",
    "sensor_offset", "cogging",
)  # fmt: skip
OUTSIDE = ("dahl", "sine", "backlash")
# kinds that act alike in part: one of each group at most, so that a drawn set has as many effects as it says
GROUPS = (
    {"coulomb_friction", "stribeck_friction"},
    {"input_gain", "mass", "length"},
    {"gravity_tilt", "sensor_offset"},
)


def _signed(rng: np.random.Generator, lo: float, hi: float) -> float:
    return float(rng.uniform(lo, hi) * rng.choice([-1.0, 1.0]))


def draw_set(rng: np.random.Generator, count: int) -> list[str]:
    """Names of `count` different effects, no two of one group."""
    while True:
        names = [str(s) for s in rng.choice(SINGLES, size=count, replace=False)]
        if all(len(group.intersection(names)) <= 1 for group in GROUPS):
            return names


def draw(rng: np.random.Generator, names: list[str]) -> Hidden:
    """Sizes for the named effects."""
    effects: list[tuple[str, str]] = []
    parameters: dict[str, dict[str, float]] = {}
    rig: dict[str, float] = {}
    delay = offset = 0.0

    def add(name: str, on: str, **values: float) -> None:
        effects.append((name, on))
        parameters[f"{name} {on}"] = values

    for name in names:
        if name == "viscous_friction":
            rig["b"] = float(rng.uniform(0.03, 0.15))
            add(name, "hinge", b=rig["b"])
        elif name == "coulomb_friction":
            rig["F_c"] = float(rng.uniform(0.03, 0.15))
            add(name, "hinge", F_c=rig["F_c"])
        elif name == "stribeck_friction":
            rig["F_c"] = float(rng.uniform(0.03, 0.15))
            rig["F_s"] = rig["F_c"] + float(rng.uniform(0.06, 0.12))
            rig["v_s"] = float(rng.uniform(0.1, 0.5))
            add(name, "hinge", F_c=rig["F_c"], F_s=rig["F_s"], v_s=rig["v_s"])
        elif name == "quadratic_drag":
            rig["c"] = float(rng.uniform(0.03, 0.12))
            add(name, "hinge", c=rig["c"])
        elif name == "input_gain":
            rig["gain"] = 1.0 + _signed(rng, 0.05, 0.2)
            add(name, "torque", ratio=rig["gain"])
        elif name == "mass":
            ratio = 1.0 + _signed(rng, 0.05, 0.2)
            rig["mass"], rig["inertia"] = NOMINAL["mass"] * ratio, NOMINAL["inertia"] * ratio
            add("parameter_error", "rod.mass", ratio=ratio)
        elif name == "length":
            ratio = 1.0 + _signed(rng, 0.03, 0.1)
            rig["com"], rig["inertia"] = NOMINAL["com"] * ratio, NOMINAL["inertia"] * ratio**2
            add("parameter_error", "rod.length", ratio=ratio)
        elif name == "input_bias":
            rig["bias"] = _signed(rng, 0.03, 0.15)
            add(name, "torque", bias=rig["bias"])
        elif name == "input_delay":
            delay = float(rng.integers(1, 4)) / RATE
            add(name, "torque", delay=delay)
        elif name == "input_lag":
            rig["lag"] = float(rng.uniform(0.01, 0.05))
            add(name, "torque", T=rig["lag"])
        elif name == "input_dead_zone":
            rig["width"] = float(rng.uniform(0.05, 0.3))
            add(name, "torque", width=rig["width"])
        elif name == "spring":
            rig["k"] = float(rng.uniform(0.1, 0.5))
            add(name, "hinge", k=rig["k"])
        elif name == "cubic_spring":
            rig["k3"] = float(rng.uniform(0.1, 0.4))
            add(name, "hinge", k3=rig["k3"])
        elif name == "gravity_tilt":
            rig["tilt"] = _signed(rng, 0.02, 0.1)
            add(name, "plant", tilt=rig["tilt"])
        elif name == "sensor_offset":
            offset = _signed(rng, 0.02, 0.1)
            add(name, "angle", offset=offset)
        elif name == "cogging":
            rig["A"], rig["n"] = float(rng.uniform(0.03, 0.1)), float(rng.integers(4, 10))
            rig["phase"] = float(rng.uniform(-np.pi, np.pi))
            add(name, "hinge", A=rig["A"], n=rig["n"], phase=rig["phase"])
        else:
            raise ValueError(name)
    return Hidden(tuple(effects), parameters, rig, delay, offset)


def draw_outside(rng: np.random.Generator, name: str) -> Hidden:
    """Something that the library cannot express."""
    if name == "dahl":
        force = float(rng.uniform(0.05, 0.15))
        rig = {"dahl": force, "dahl_stiffness": force / float(rng.uniform(0.02, 0.1))}
    elif name == "sine":
        rig = {"sine": float(rng.uniform(0.05, 0.15)), "sine_hz": float(rng.uniform(0.3, 5.0))}
        rig["sine_phase"] = float(rng.uniform(-np.pi, np.pi))
    elif name == "backlash":
        rig = {"play": float(rng.uniform(0.01, 0.05)), "play_stiffness": 50.0}
    else:
        raise ValueError(name)
    return Hidden((), {}, rig, library=False)
