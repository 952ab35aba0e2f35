"""Effects that stand in for others, or are left out because the rest comes within the noise without them."""

from __future__ import annotations

import pytest

from tests.undeclared.plant import pendulum
from tests.undeclared.rig.seal import produce
from tests.undeclared.scoring import examine


def test_one_effect_takes_the_place_of_two_that_look_like_it(tmp_path):
    produce(tmp_path, "spring, tilt", 1001)
    _, mark = examine(tmp_path, pendulum(), False)
    assert (mark.verdict, mark.exact) == ("attributed", True)
    assert mark.answer == [["gravity_tilt", "plant"], ["spring", "hinge"]]
    assert set(mark.errors) == {"gravity_tilt.tilt", "spring.k"}
    assert max(mark.errors.values()) <= 0.005


@pytest.mark.parametrize("seed", [1006, 1010, 1013])
def test_three_effects_of_which_two_come_within_the_noise(tmp_path, seed):
    """A lag and a spring without a delay; a ripple and an inertia for a spring and a length; drag without friction."""
    produce(tmp_path, "three", seed)
    _, mark = examine(tmp_path, pendulum(), False)
    assert (mark.verdict, mark.exact, len(mark.answer)) == ("attributed", True, 3)


def test_a_small_stribeck_peak_is_no_ripple(tmp_path):
    produce(tmp_path, "faint peak", 1019)
    _, mark = examine(tmp_path, pendulum(), False)
    assert (mark.verdict, mark.answer) == ("attributed", [["stribeck_friction", "hinge"]])
