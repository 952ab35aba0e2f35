"""Effects, sizes and signs drawn at random from the reference set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tests.undeclared.rig.pendulum import NOMINAL, RATE, STEP, Draft, Hidden

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
# the whole range: what SINGLES lacks, and delays between samples in the place of whole ones
ADDED = ("input_saturation", "com", "inertia", "fractional_delay")
WIDE = (*(name for name in SINGLES if name != "input_delay"), *ADDED)
# kinds of which two are one effect and no more
SAME = ({"coulomb_friction", "stribeck_friction"}, {"input_gain", "mass"}, {"gravity_tilt", "sensor_offset"})

Size = Callable[[np.random.Generator, Draft], None]


def signed(rng: np.random.Generator, lo: float, hi: float) -> float:
    """A size between `lo` and `hi` of either sign."""
    return float(rng.uniform(lo, hi) * rng.choice([-1.0, 1.0]))


def _number(name: str, on: str, symbol: str, lo: float, hi: float, key: str = "", either: bool = False) -> Size:
    """An effect of one number, which the integrator knows as `key`."""

    def size(rng: np.random.Generator, draft: Draft) -> None:
        value = signed(rng, lo, hi) if either else float(rng.uniform(lo, hi))
        draft.rig[key or symbol] = value
        draft.add(name, on, **{symbol: value})

    return size


def _error(on: str, lo: float, hi: float, powers: Mapping[str, int]) -> Size:
    """A named parameter off by a ratio; `powers` of it scale the integrator's numbers."""

    def size(rng: np.random.Generator, draft: Draft) -> None:
        ratio = 1.0 + signed(rng, lo, hi)
        for key, power in powers.items():
            draft.rig[key] = draft.rig.get(key, NOMINAL[key]) * ratio**power
        draft.add("parameter_error", on, ratio=ratio)

    return size


def _gain(rng: np.random.Generator, draft: Draft) -> None:
    draft.rig["gain"] = 1.0 + signed(rng, 0.05, 0.2)
    draft.add("input_gain", "torque", ratio=draft.rig["gain"])


def _stribeck(rng: np.random.Generator, draft: Draft) -> None:
    stribeck(rng, draft, (0.06, 0.12), (0.1, 0.5))


def stribeck(rng: np.random.Generator, draft: Draft, peak: tuple[float, float], width: tuple[float, float]) -> None:
    """Coulomb friction with a peak of a height and a width between the given limits."""
    level = float(rng.uniform(0.03, 0.15))
    numbers = {"F_c": level, "F_s": level + float(rng.uniform(*peak)), "v_s": float(rng.uniform(*width))}
    draft.rig.update(numbers)
    draft.add("stribeck_friction", "hinge", **numbers)


def _whole_delay(rng: np.random.Generator, draft: Draft) -> None:
    draft.delay = float(rng.integers(1, 4)) / RATE
    draft.add("input_delay", "torque", delay=draft.delay)


def _fractional_delay(rng: np.random.Generator, draft: Draft) -> None:
    """Up to four samples, at least 15 % of a sample away from a whole number of them; whole steps of the rig."""
    samples = float(rng.integers(0, 4)) + float(rng.uniform(0.15, 0.85))
    draft.delay = round(samples / RATE / STEP) * STEP
    draft.add("input_delay", "torque", delay=draft.delay)


def _offset(rng: np.random.Generator, draft: Draft) -> None:
    draft.offset = signed(rng, 0.02, 0.1)
    draft.add("sensor_offset", "angle", offset=draft.offset)


def _cogging(rng: np.random.Generator, draft: Draft) -> None:
    numbers = {"A": float(rng.uniform(0.03, 0.1)), "n": float(rng.integers(4, 10))}
    numbers["phase"] = float(rng.uniform(-np.pi, np.pi))
    draft.rig.update(numbers)
    draft.add("cogging", "hinge", **numbers)


SIZES: Mapping[str, Size] = {
    "viscous_friction": _number("viscous_friction", "hinge", "b", 0.03, 0.15),
    "coulomb_friction": _number("coulomb_friction", "hinge", "F_c", 0.03, 0.15),
    "stribeck_friction": _stribeck,
    "quadratic_drag": _number("quadratic_drag", "hinge", "c", 0.03, 0.12),
    "input_gain": _gain,
    "mass": _error("rod.mass", 0.05, 0.2, {"mass": 1, "inertia": 1}),
    "length": _error("rod.length", 0.03, 0.1, {"com": 1, "inertia": 2}),
    "com": _error("rod.com", 0.03, 0.15, {"com": 1}),
    "inertia": _error("rod.inertia", 0.05, 0.2, {"inertia": 1}),
    "input_bias": _number("input_bias", "torque", "bias", 0.03, 0.15, either=True),
    "input_delay": _whole_delay,
    "fractional_delay": _fractional_delay,
    "input_lag": _number("input_lag", "torque", "T", 0.01, 0.05, "lag"),
    "input_dead_zone": _number("input_dead_zone", "torque", "width", 0.05, 0.3),
    "input_saturation": _number("input_saturation", "torque", "limit", 1.0, 2.5),
    "spring": _number("spring", "hinge", "k", 0.1, 0.5),
    "cubic_spring": _number("cubic_spring", "hinge", "k3", 0.1, 0.4),
    "gravity_tilt": _number("gravity_tilt", "plant", "tilt", 0.02, 0.1, either=True),
    "sensor_offset": _offset,
    "cogging": _cogging,
}


def draw_set(
    rng: np.random.Generator, count: int, kinds: Sequence[str] = SINGLES, groups: Sequence[set[str]] = GROUPS
) -> list[str]:
    """Names of `count` different effects, no two of one group."""
    while True:
        names = [str(s) for s in rng.choice(kinds, size=count, replace=False)]
        if all(len(group.intersection(names)) <= 1 for group in groups):
            return names


def draw(rng: np.random.Generator, names: Sequence[str]) -> Hidden:
    """Sizes for the named effects."""
    draft = Draft()
    for name in names:
        SIZES[name](rng, draft)
    return draft.hidden()


def draw_outside(rng: np.random.Generator, name: str) -> Hidden:
    """Something that the library cannot express; or friction with memory, which it could not for long."""
    if name == "dahl":
        force = float(rng.uniform(0.05, 0.15))
        way = float(rng.uniform(0.02, 0.1))
        rig = {"dahl": force, "dahl_stiffness": force / way}
        return Hidden((("dahl_friction", "hinge"),), {"dahl_friction hinge": {"F_c": force, "d": way}}, rig)
    if name == "sine":
        rig = {"sine": float(rng.uniform(0.05, 0.15)), "sine_hz": float(rng.uniform(0.3, 5.0))}
        rig["sine_phase"] = float(rng.uniform(-np.pi, np.pi))
    elif name == "backlash":
        rig = {"play": float(rng.uniform(0.01, 0.05)), "play_stiffness": 50.0}
    else:
        raise ValueError(name)
    return Hidden((), {}, rig, library=False)
