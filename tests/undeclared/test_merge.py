"""Two effects that stand in for one: a ripple and an error of the centre of mass follow a spring closely."""

from __future__ import annotations

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
