"""What the library cannot express is never `attributed`: the verdicts that the documentation tells."""

from __future__ import annotations

import pytest

from tests.undeclared.plant import pendulum
from tests.undeclared.rig.seal import produce
from tests.undeclared.scoring import examine


@pytest.mark.parametrize(("kind", "verdict"), [("sine", "unexplained"), ("backlash", "partial")])
def test_outside_the_library(tmp_path, kind, verdict):
    produce(tmp_path, kind, 0)
    diagnosis, mark = examine(tmp_path, pendulum(), False)
    assert mark.verdict == verdict
    assert bool(mark.answer) == (verdict == "partial")
    assert mark.held_out_ratio > 1.08  # something is left, and the figures say so
    if verdict == "partial":
        assert mark.held_out_ratio < diagnosis.before.held_out_ratio


@pytest.mark.parametrize("seed", [3, 1001])
def test_play_that_looks_like_noise_that_remembers_is_not_attributed(tmp_path, seed):
    """Its trace was taken for coloured noise, and an error of mass or inertia `attributed` in its place."""
    produce(tmp_path, "backlash", seed)
    diagnosis, mark = examine(tmp_path, pendulum(), False)
    assert mark.verdict == "partial"
    assert "coloured_noise" not in [f.fault for f in diagnosis.recording]


def test_friction_with_memory_is_named(tmp_path):
    """Dahl friction, by another integrator: once `partial` under other names, now in the library."""
    produce(tmp_path, "dahl", 0)
    diagnosis, mark = examine(tmp_path, pendulum(), False)
    assert mark.verdict == "attributed"
    assert mark.answer == mark.truth == [["dahl_friction", "hinge"]]
    assert max(mark.errors.values()) < 0.01
    assert diagnosis.after.held_out_ratio < 1.05
