"""A push by hand in about a hundredth of the time: what else is missing is found, and where the push was is told."""

from __future__ import annotations

import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import Hidden, dc_motor, oscillator

FEW = ("viscous_friction", "coulomb_friction", "input_gain", "input_bias", "spring")
PLANTS = {"oscillator": (oscillator(), "slide", 0.3, 15.0), "dc_motor": (dc_motor(), "shaft", 0.012, 0.3)}
AT = ((0, 3.42, 3.52), (1, 6.31, 6.41))


def _diagnosed(name, friction, pushes=AT, seed=1, seconds=10.0):
    plant, joint, dry, force = PLANTS[name]
    hidden = Hidden(
        coulomb={joint: dry} if friction else {}, pushes=tuple((k, a, b, joint, force) for k, a, b in pushes)
    )
    return diagnose(nominal(name), record(plant, hidden, seed, seconds=seconds), DiagnosisSettings(effects=FEW)), dry


def _pushes(d):
    return [f for f in d.recording if f.fault == "push"]


@pytest.mark.parametrize("name", list(PLANTS))
def test_dry_friction_of_a_plant_that_is_pushed_is_named(name):
    d, dry = _diagnosed(name, True)
    assert d.verdict in ("attributed", "partial")
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    lo, hi = d.effects[0].parameters["F_c"].ci95
    assert lo <= dry <= hi
    (push,) = _pushes(d)
    assert "run1" in push.sentence or "run2" in push.sentence
    assert 0.05 < push.value < 0.8  # two tenths of a second were pushed


@pytest.mark.parametrize("name", list(PLANTS))
def test_a_perfect_model_of_a_plant_that_is_pushed_lacks_nothing(name):
    d, _ = _diagnosed(name, False)
    assert (d.verdict, d.effects) == ("none", ())
    assert len(_pushes(d)) == 1


def test_friction_without_a_push_is_no_push():
    d, _ = _diagnosed("oscillator", True, pushes=())
    assert d.verdict == "attributed"
    assert _pushes(d) == []


def test_a_force_that_acts_half_of_the_time_is_no_push():
    spells = [(k, 1.0 + 2 * j, 2.0 + 2 * j) for k in (0, 1) for j in range(4)]
    plant, joint, *_ = PLANTS["oscillator"]
    hidden = Hidden(pushes=tuple((k, a, b, joint, 3.0) for k, a, b in spells))
    settings = DiagnosisSettings(effects=FEW, max_effects=1)
    d = diagnose(nominal("oscillator"), record(plant, hidden, 1, seconds=10.0), settings)
    assert d.verdict == "unexplained"
    assert _pushes(d) == []
