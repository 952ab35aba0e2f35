"""What was commanded before the first sample, a command with the wrong sign, and names that are not deserved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simgap.diagnosis.conclude import Evidence, verdict
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.confidence import vanishing
from simgap.diagnosis.search.explanations import Explanation
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.verdict.held_out import HeldOut
from simgap.diagnosis.verdict.score import Errors, Gain
from simgap.effects import EFFECTS
from simgap.effects.base import Quoted
from simgap.model.symbolic import SymbolicModel, Variable, symbol
from tests.diagnosis.plants import block, point_pendulum
from tests.undeclared.rig import dry_friction, pendulum

NAMED = ("coulomb_friction", "stribeck_friction", "input_gain", "input_saturation")


def _record(traces, states, inputs):
    return Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), states, inputs)


def test_the_first_window_of_each_trace_begins_where_its_commands_are_known():
    traces = tuple(Trace(f"t{k}", 5.0 + np.arange(300) * 0.01, np.zeros((300, 1)), np.zeros((300, 1))) for k in (0, 1))
    record = Record(traces, ("q",), ("u",))
    windows = split_windows(record, 1.0)
    problem = build_problem(cached_supermodel(block(), ("q",)), record, windows, np.ones(1))
    known = problem.past_the_unknown(0.22).windows
    assert (known.start - windows.start).tolist() == [22, 0, 0, 22, 0, 0]
    assert known.trace.tolist() == windows.trace.tolist()
    assert problem.past_the_unknown(0.98).windows.start.tolist() == [100, 200, 400, 500]  # the rest is too short
    assert problem.past_the_unknown(60.0).windows is windows


def test_a_delay_in_a_record_that_begins_in_mid_motion_is_attributed():
    drive = dry_friction.Drive(viscous=0.4, late=12)
    record = _record(dry_friction.drive_record(drive, 6, seconds=8.0, moving=True), ("q",), ("u",))
    settings = DiagnosisSettings(effects=("input_delay", "viscous_friction", "input_bias"))
    d = diagnose(block(2.0), record, settings)
    assert d.verdict == "attributed"
    values = {e.name: next(iter(e.parameters.values())) for e in d.effects}
    assert set(values) == {"input_delay", "viscous_friction"}
    assert values["input_delay"].value == pytest.approx(0.06, abs=2e-4)
    assert values["viscous_friction"].value == pytest.approx(0.4, rel=0.01)
    assert d.after.chi2_dof < 1.1


def test_a_reversed_input_is_found_and_said():
    hidden = pendulum.Hidden(rig={"gain": -0.9, "b": 0.1})
    traces = pendulum.record(hidden, np.random.default_rng(21), 1e-3, False, seconds=8.0)
    settings = DiagnosisSettings(effects=("input_gain", "input_bias", "viscous_friction", "coulomb_friction"))
    d = diagnose(point_pendulum(1.0, 0.5, 1.0 / 3.0), _record(traces, ("angle",), ("torque",)), settings)
    assert d.verdict == "attributed"
    found = {e.name: e.parameters for e in d.effects}
    assert set(found) == {"input_gain", "viscous_friction"}
    assert found["input_gain"]["ratio"].value == pytest.approx(-0.9, rel=0.005)
    assert found["input_gain"]["ratio"].ci95[1] < -0.85


def test_the_sentence_says_reversed():
    ratio = {"value": -0.9, "ci95": [-0.91, -0.89], "unit": "1"}
    assert "reversed" in EFFECTS["input_gain"].describe("torque", Quoted({"ratio": ratio}))
    ratio = {"value": 0.9, "ci95": [0.89, 0.91], "unit": "1"}
    assert "reversed" not in EFFECTS["input_gain"].describe("torque", Quoted({"ratio": ratio}))


@pytest.mark.parametrize(
    ("name", "on", "values", "errors", "gone"),
    [
        ("coulomb_friction", "hinge", [0.1], [0.04], False),
        ("coulomb_friction", "hinge", [0.1], [0.06], True),
        ("input_gain", "torque", [0.9], [0.06], True),
        ("input_gain", "torque", [0.9], [0.04], False),
        ("stribeck_friction", "hinge", [0.1, 0.2, 0.1], [0.01, 0.5, 9.0], False),  # the level is sure, the peak is not
        ("stribeck_friction", "hinge", [0.1, 0.2, 0.5], [0.1, 0.5, 1e-3], True),  # a sure speed of nothing
        ("input_saturation", "torque", [2.0], [0.1], False),  # commands reach 3
        ("input_saturation", "torque", [2.9], [0.1], True),
    ],
)
def test_an_interval_that_contains_no_effect_is_seen(name, on, values, errors, gone):
    t = np.arange(0.0, 2.0, 0.01)
    compiled = cached_supermodel(point_pendulum(1.0, 0.5, 1.0 / 3.0), ("angle",), NAMED)
    record = _record([(t, np.zeros((len(t), 1)), 3.0 * np.cos(t)[:, None])], ("angle",), ("torque",))
    problem = build_problem(compiled, record, split_windows(record, 1.0), np.ones(1))
    member = compiled.find(name, on)
    theta = compiled.null.copy()
    theta[list(member.slots)] = values
    at = Fit(theta, np.zeros((1, 2)), member.slots, 1.0, np.eye(len(values)), (), True)
    assert bool(vanishing(problem, (member,), at, np.array(errors), 1000)) == gone


def _asked() -> tuple[HeldOut, Evidence]:
    none = Errors(np.zeros((1, 1)), np.zeros(1, dtype=np.int64))
    held = HeldOut(np.zeros((1, 2)), np.ones(1), 1.0, 100.0, 100, np.ones(1), None, none)
    return held, Evidence(False, True, held, held, 0.01, Gain(1.0, 0.1), borne_out=True, agree=True, needed=True)


def test_a_fit_that_has_not_settled_is_no_more_than_partial():
    compiled = cached_supermodel(point_pendulum(1.0, 0.5, 1.0 / 3.0), ("angle",), NAMED)
    at = Fit(compiled.null, np.zeros((1, 2)), (0,), 1.0, np.eye(1), (), True)
    found = Explanation((compiled.candidates[0],), at, 1.0, True)
    _, asked = _asked()
    unsettled = replace(found, fit=replace(at, converged=False))
    assert verdict(found, asked) == "attributed"
    assert verdict(unsettled, asked) == "partial"
    assert verdict(unsettled, replace(asked, gain=Gain(1.0, 1.1))) == "unexplained"


@pytest.mark.parametrize("changed", [{"needed": False}, {"corrected": 1.2}])
def test_what_confirms_must_ask_for_every_effect_and_be_down_to_its_noise(changed):
    compiled = cached_supermodel(point_pendulum(1.0, 0.5, 1.0 / 3.0), ("angle",), NAMED)
    found = Explanation(
        (compiled.candidates[0],), Fit(compiled.null, np.zeros((1, 2)), (0,), 1.0, np.eye(1), (), True), 1.0, True
    )
    held, asked = _asked()
    if "corrected" in changed:
        changed = {"corrected": replace(held, ratio=changed["corrected"], chi2=1440.0, free=1000)}
    assert verdict(found, replace(asked, **changed)) == "partial"
    assert verdict(found, replace(asked, agree=False, **changed)) == "unexplained"


def test_what_is_not_compared_is_said_with_the_effect_that_reaches_so_far_back():
    """A heater whose power lags 20 s behind its command, switched on 20 s after the record begins."""
    dt, rng = 4.0, np.random.default_rng(72)
    t = dt * np.arange(160)
    power = np.where(t < 20.0, 0.0, 50.0)
    felt, heat = np.zeros(160), np.zeros(160)
    for k in range(159):  # exact for a power held between stamps
        gone = np.exp(-dt / 20.0)
        felt[k + 1] = power[k] + (felt[k] - power[k]) * gone
        mean = power[k] + (felt[k] - power[k]) * (1.0 - gone) * 20.0 / dt
        heat[k + 1] = heat[k] * np.exp(-0.006 * dt) + mean * (1.0 - np.exp(-0.006 * dt)) / 1.2
    T, Q = symbol("T"), symbol("Q")
    plant = SymbolicModel(
        states=(Variable("T", "degC"),), inputs=(Variable("Q", "1"),), xdot=(0.005 * Q - 0.006 * T,), parameters={}
    )
    readings = heat[:, None] + 0.1 * rng.standard_normal((160, 1))
    record = _record([(t, readings, power[:, None])], ("T",), ("Q",))
    d = diagnose(plant, record, DiagnosisSettings(window_s=120.0, horizon_s=60.0, effects=("input_lag", "input_gain")))
    (said,) = [w for w in d.warnings if "not compared" in w]
    assert "the lag of Q, found on the whole of it" in said
