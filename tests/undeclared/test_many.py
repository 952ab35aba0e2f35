"""Four things wrong at once, a delay and dry friction with rests among them, read by an encoder."""

from __future__ import annotations

import pytest

from simgap.diagnosis.diagnose import diagnose
from tests.undeclared.many import many_model, many_record


def test_four_effects_are_found_where_no_single_one_leads_there():
    record, truth = many_record("motor", ("viscous", "dry", "gain", "delay"), 0, 12.0)
    d = diagnose(many_model("motor"), record)
    assert d.verdict == "attributed"
    right = frozenset(truth)
    answer = {frozenset((e.name, e.on) for e in d.effects): True}
    sets = answer | {frozenset((a.name, a.on) for a in s.effects): s.exact for s in d.alternatives}
    assert sets.get(right)  # a gain beside friction moves the motor exactly as an error of the inertia does
    delay = next(e for e in d.effects if e.name == "input_delay").parameters["delay"]
    assert delay.value == pytest.approx(truth["input_delay", "u"]["delay"], rel=0.02)


def test_nothing_is_named_where_nothing_is_missing():
    record, _ = many_record("motor", (), 0, 12.0)
    assert diagnose(many_model("motor"), record).verdict == "none"
