"""Effects that are easily taken for others, and those that the first part of the study does not draw."""

from __future__ import annotations

import numpy as np
import pytest

from tests.undeclared.plant import pendulum
from tests.undeclared.rig import alike, draw
from tests.undeclared.rig import pendulum as rig
from tests.undeclared.rig.seal import produce
from tests.undeclared.scoring import examine


@pytest.mark.parametrize("kind", ["input_saturation", "inertia", "fractional_delay"])
def test_one_effect_of_the_whole_range(tmp_path, kind):
    produce(tmp_path, kind, 0)
    _, mark = examine(tmp_path, pendulum(), False)
    assert (mark.verdict, mark.exact) == ("attributed", True)
    (error,) = (mark.errors or mark.listed_errors).values()
    assert error <= 0.005


def test_a_drawn_delay_is_no_whole_number_of_samples():
    rng = np.random.default_rng(1)
    delays = [draw.draw(rng, ["fractional_delay"]).delay * rig.RATE for _ in range(200)]
    assert min(abs(d - round(d)) for d in delays) > 0.14
    assert min(delays) < 0.5
    assert max(delays) > 3.5


@pytest.mark.parametrize("name", ["gain, mass", "tilt, offset"])
def test_two_effects_that_are_one_move_as_that_one(name):
    hidden = alike.draw_alike(np.random.default_rng(2), name)
    ((effect, on),) = hidden.effects
    (size,) = hidden.parameters[f"{effect} {on}"].values()
    alone = rig.Hidden(rig={{"input_gain": "gain", "gravity_tilt": "tilt"}[effect]: size})
    u = rig.multisine(np.random.default_rng(3), 801, rig.RATE)
    read = [rig.move(h, u, np.array([0.3 - h.offset, 0.1])) + np.array([h.offset, 0.0]) for h in (hidden, alone)]
    np.testing.assert_allclose(read[0], read[1], atol=1e-9)
    assert len(hidden.rig) + bool(hidden.offset) > len(alone.rig)  # two, though they move as one


@pytest.mark.parametrize("name", ["gain, mass", "tilt, offset"])
def test_two_effects_that_are_one_are_found_as_one(tmp_path, name):
    produce(tmp_path, name, 0)
    _, mark = examine(tmp_path, pendulum(), False)
    assert (mark.verdict, mark.exact, len(mark.answer)) == ("attributed", True, 1)
    (error,) = (mark.errors or mark.listed_errors).values()
    assert error <= 0.005
