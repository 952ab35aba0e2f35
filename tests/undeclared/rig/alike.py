"""Hidden effects that are easily taken for others: two that act alike, and two that are one.

Where two effects move the plant as a single one does, no data can show that there are two: the single one is sealed,
worked out by hand here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.undeclared.rig.draw import draw, stribeck
from tests.undeclared.rig.pendulum import Draft, Hidden

# two effects that act alike over part of the motion, and differ over the rest
PAIRS: Mapping[str, tuple[str, str]] = {
    "delay, lag": ("fractional_delay", "input_lag"),
    "spring, tilt": ("spring", "gravity_tilt"),
    "spring, centre of mass": ("spring", "com"),
    "spring, cubic spring": ("spring", "cubic_spring"),
    "bias, tilt": ("input_bias", "gravity_tilt"),
    "gain, inertia": ("input_gain", "inertia"),
    "gain, saturation": ("input_gain", "input_saturation"),
    "dead zone, Coulomb": ("input_dead_zone", "coulomb_friction"),
    "viscous, drag": ("viscous_friction", "quadratic_drag"),
}
_SMALLEST = 0.03  # of what two effects that are one leave: less would be another study, of nothing hidden


def gain_and_mass(rng: np.random.Generator) -> Hidden:
    """I a = u - m g l sin q with g u and r m, r I: the gain g / r alone."""
    while True:
        both = draw(rng, ["input_gain", "mass"])
        ratio = both.rig["gain"] / both.rig["mass"]
        if abs(ratio - 1.0) > _SMALLEST:
            return _as_one(both, "input_gain", "torque", ratio=ratio)


def tilt_and_offset(rng: np.random.Generator) -> Hidden:
    """A reading y = q + o of a plant tilted by a: sin(q + a) = sin(y + a - o), the tilt a - o alone."""
    while True:
        both = draw(rng, ["gravity_tilt", "sensor_offset"])
        tilt = both.rig["tilt"] - both.offset
        if abs(tilt) > _SMALLEST:
            return _as_one(both, "gravity_tilt", "plant", tilt=tilt)


def _as_one(both: Hidden, name: str, on: str, **values: float) -> Hidden:
    return Hidden(((name, on),), {f"{name} {on}": values}, both.rig, both.delay, both.offset)


def faint_peak(rng: np.random.Generator) -> Hidden:
    """Stribeck friction whose peak is small and narrow: nearly Coulomb friction."""
    draft = Draft()
    stribeck(rng, draft, (0.01, 0.04), (0.05, 0.2))
    return draft.hidden()


ONES = {"gain, mass": gain_and_mass, "tilt, offset": tilt_and_offset, "faint peak": faint_peak}


def draw_alike(rng: np.random.Generator, name: str) -> Hidden:
    """Hidden effects of PAIRS or ONES."""
    return draw(rng, PAIRS[name]) if name in PAIRS else ONES[name](rng)
