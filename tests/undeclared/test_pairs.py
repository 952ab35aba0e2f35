"""Two effects that act alike, or that together look like others."""

from __future__ import annotations

import json

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import Diagnosis
from tests.undeclared.plant import pendulum
from tests.undeclared.rig import pendulum as rig
from tests.undeclared.rig.seal import produce
from tests.undeclared.scoring import examine


def test_delay_and_lag_are_told_apart(tmp_path):
    produce(tmp_path, "delay, lag", 0)
    diagnosis, mark = examine(tmp_path, pendulum(), False)
    sealed = json.loads((tmp_path / "sealed.json").read_text())["parameters"]
    assert (mark.verdict, mark.exact) == ("attributed", True)
    found = {e.name: next(iter(e.parameters.values())) for e in diagnosis.effects}
    true = {"input_delay": sealed["input_delay torque"]["delay"], "input_lag": sealed["input_lag torque"]["T"]}
    assert set(found) == set(true)
    for name, p in found.items():
        assert abs(p.value - true[name]) <= p.ci95[1] - p.ci95[0]
    assert sum(p.value for p in found.values()) == pytest.approx(
        sum(true.values()), rel=0.005
    )  # what the data tell well


def _diagnosed(hidden: rig.Hidden, seed: int) -> Diagnosis:
    traces = rig.record(hidden, np.random.default_rng(seed), 1e-3, False, seconds=8.0)
    record = Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), ("angle",), ("torque",))
    return diagnose(pendulum(), record)


def test_a_strong_stribeck_peak_is_found_from_the_coulomb_fit():
    d = _diagnosed(rig.Hidden(rig={"F_c": 0.12, "F_s": 0.22, "v_s": 0.14}), 11)
    assert d.verdict == "attributed"
    assert [e.name for e in d.effects] == ["stribeck_friction"]
    p = d.effects[0].parameters
    assert p["F_c"].value == pytest.approx(0.12, rel=0.01)
    assert p["F_s"].ci95[0] <= 0.22 <= p["F_s"].ci95[1]  # eight seconds tell the peak from its width only roughly
    assert p["v_s"].ci95[0] <= 0.14 <= p["v_s"].ci95[1]


def test_two_effects_that_together_look_like_others():
    d = _diagnosed(rig.Hidden(rig={"gain": 1.18, "k": 0.4}), 12)
    assert d.verdict == "attributed"
    answer = {e.name: {s: p.value for s, p in e.parameters.items()} for e in d.effects}
    proven = [{a.name: a.values for a in s.effects} for s in d.alternatives if s.exact]
    (right,) = [s for s in (answer, *proven) if set(s) == {"input_gain", "spring"}]
    assert right["input_gain"]["ratio"] == pytest.approx(1.18, rel=0.005)
    assert right["spring"]["k"] == pytest.approx(0.4, rel=0.01)
