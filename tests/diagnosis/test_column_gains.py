"""A unit or a sign is a possibility of its own: no gain beside it may make it another one."""

from __future__ import annotations

import numpy as np
import pytest

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import columns
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.parts import parts_of
from tests.undeclared.rig import robot
from tests.undeclared.test_robot import _declared


def test_a_unit_is_not_saved_by_a_reversed_gain_far_from_one(monkeypatch):
    """A robot that turns the other way, half as fast, read at 7.8 Hz: turns a minute and a gain of -4.7 fit as well."""
    monkeypatch.setattr(robot, "RATE", 1.0 / 0.128)
    runs = robot.record({"turn_gain": -0.497}, np.random.default_rng([1, 83]), heading=True)
    record = Record(tuple(Trace(f"run{k}", *r) for k, r in enumerate(runs)), ("x", "y", "theta"), ("v", "w"))
    parts, _ = parts_of(_declared(), record, DiagnosisSettings(window_s=2.0, horizon_s=2.0))
    whole = coarse(parts.known)
    part = whole.on(whole.windows.pick(np.linspace(0, len(whole.windows) - 1, 8).astype(int)))
    options = {(o.finding.fault, o.finding.channel, o.words): o for o in columns._options(part)}
    unit = options["wrong_unit", "w", "w in turns a minute"]
    reversed_ = options["wrong_sign", "w", ""]
    assert columns._missed_beside_effects(unit.applied(part), np.inf) > 100.0
    assert columns._missed_beside_effects(reversed_.applied(part), np.inf) == pytest.approx(1.0, abs=0.2)
    assert columns.better_columns(whole) is None  # the sign is left to the gain that the search finds
