"""A plant that changes in mid-record: when, what, and no change where there is none."""

from __future__ import annotations

import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import Hidden, oscillator, pendulum

FEW = ("viscous_friction", "coulomb_friction", "parameter_error", "input_bias")


def _diagnosed(plant, hidden, traces=1, seconds=24.0):
    made = record(plant, hidden, 2, seconds=seconds, traces=traces)
    return diagnose(nominal(plant.name), made, DiagnosisSettings(effects=FEW))


def _changes(d):
    return [f for f in d.recording if f.fault == "plant_changed"]


def test_friction_that_doubles_at_an_instant_is_told_with_both_numbers():
    d = _diagnosed(oscillator(), Hidden(viscous={"slide": 0.3}, after=(0, 14.0), later=Hidden(viscous={"slide": 0.6})))
    (change,) = _changes(d)
    assert change.value == pytest.approx(14.0, abs=1.0)
    assert "viscous friction of 0.3" in change.sentence
    assert "0.6" in change.sentence
    assert d.verdict == "attributed"
    assert [e.name for e in d.effects] == ["viscous_friction"]
    lo, hi = d.effects[0].parameters["b"].ci95
    assert lo <= 0.3 <= hi  # of what came before, which is longer


def test_a_load_that_is_added_is_told_beside_a_model_that_was_right():
    d = _diagnosed(pendulum(), Hidden(after=(0, 9.0), later=Hidden(factors={"m": 1.2})))
    (change,) = _changes(d)
    assert change.value == pytest.approx(9.0, abs=1.0)
    assert d.verdict == "attributed"
    sets = [{(e.name, e.on) for e in d.effects}, *({(e.name, e.on) for e in a.effects} for a in d.alternatives)]
    assert {("parameter_error", "I")} in sets


def test_a_plant_that_stays_as_it_is_did_not_change():
    d = _diagnosed(oscillator(), Hidden(viscous={"slide": 0.3}))
    assert (d.verdict, _changes(d)) == ("attributed", [])


def test_a_force_outside_the_library_is_no_change():
    pushes = tuple((0, 1.0 + 2 * j, 2.0 + 2 * j, "slide", 3.0) for j in range(11))
    d = _diagnosed(oscillator(), Hidden(pushes=pushes))
    assert d.verdict != "attributed"
    assert _changes(d) == []
