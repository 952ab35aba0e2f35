"""Effects that are easily taken for others, and those that the first part of the study does not draw."""

from __future__ import annotations

import json

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.result import Diagnosis
from tests.undeclared.plant import pendulum
from tests.undeclared.rig import alike, draw
from tests.undeclared.rig import pendulum as rig
from tests.undeclared.rig.seal import produce
from tests.undeclared.scoring import examine


@pytest.mark.parametrize("kind", ["input_saturation", "inertia", "com", "fractional_delay"])
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


def test_delay_and_lag_are_told_apart(tmp_path):
    produce(tmp_path, "delay, lag", 0)
    diagnosis, mark = examine(tmp_path, pendulum(), False)
    sealed = json.loads((tmp_path / "sealed.json").read_text())["parameters"]
    assert (mark.verdict, mark.exact) == ("attributed", True)
    found = {e.name: e.parameters for e in diagnosis.effects}
    assert set(found) == {"input_delay", "input_lag"}
    assert found["input_delay"]["delay"].value == pytest.approx(sealed["input_delay torque"]["delay"], rel=0.05)
    assert found["input_lag"]["T"].value == pytest.approx(sealed["input_lag torque"]["T"], rel=0.05)


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
