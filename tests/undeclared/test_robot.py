"""A wheeled robot with an undeclared effect, from files of its commands and poses, as `simgap diagnose` reads them.

Thresholds: in every record the right set is the answer or among its alternatives; where it is the answer, its parameter
is within 5 % (delay, lag: 10 %). A leaking wheel is never `attributed`, nothing hidden is `none`.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.measured import MeasuredSection
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings
from simgap.model.symbolic import SymbolicModel
from simgap.plants.plant_model import PlantModel
from simgap.stages import diagnosis as stage
from simgap.stages.measured_data import load_reading
from tests.undeclared.rig.robot_seal import produce

CASE = Path(__file__).parents[2] / "configs" / "cases" / "turtlebot.yaml"
LIBRARY = ("input_gain", "input_bias", "wheel_mismatch", "lateral_slip", "input_delay", "input_lag", "sensor_offset")


@lru_cache(maxsize=1)
def _declared() -> SymbolicModel:
    return PlantModel.of(load_case(CASE), CASE.parent).corrected


def _diagnose(folder: Path, kind: str, seed: int, heading: bool = True) -> tuple[Diagnosis, dict]:
    paths = produce(folder, kind, seed, heading)
    record = load_reading(_declared(), MeasuredSection(window_s=2.0), paths, folder).record
    settings = DiagnosisSettings(window_s=2.0, horizon_s=2.0, effects=LIBRARY, max_effects=2)
    d = diagnose(_declared(), record, settings)
    return d, json.loads((folder / "sealed.json").read_text())


def _judge(d: Diagnosis, sealed: dict, tolerance: float) -> None:
    truth = {(name, on) for name, on in sealed["effects"]}
    answer = {(e.name, e.on): e.parameters for e in d.effects}
    sets = [set(answer), *({(a.name, a.on) for a in s.effects} for s in d.alternatives)]
    assert d.verdict == "attributed"
    assert truth in sets
    if set(answer) == truth:
        for key, parameters in sealed["parameters"].items():
            name, on = key.split()
            for symbol, size in parameters.items():
                assert answer[name, on][symbol].value == pytest.approx(size, rel=tolerance)


@pytest.mark.parametrize(
    "kind", ["speed gain", "turn gain", "speed bias", "turn bias", "wheels", "slip", "heading offset"]
)
def test_one_hidden_effect(tmp_path, kind):
    _judge(*_diagnose(tmp_path, kind, 1), tolerance=0.05)


@pytest.mark.parametrize("kind", ["late turning", "slow turning"])
def test_commands_that_act_late(tmp_path, kind):
    _judge(*_diagnose(tmp_path, kind, 1), tolerance=0.1)


@pytest.mark.parametrize("kind", ["speed gain", "turn bias", "slow turning"])
def test_one_hidden_effect_without_heading(tmp_path, kind):
    _judge(*_diagnose(tmp_path, kind, 2, heading=False), tolerance=0.1)


@pytest.mark.parametrize("heading", [True, False])
def test_a_leaking_wheel_is_not_attributed(tmp_path, heading):
    assert _diagnose(tmp_path, "leaking wheel", 1, heading)[0].verdict != "attributed"


@pytest.mark.parametrize("heading", [True, False])
def test_nothing_hidden(tmp_path, heading):
    assert _diagnose(tmp_path, "nothing", 1, heading)[0].verdict == "none"


@pytest.mark.parametrize(("kind", "heading"), [("turn gain", True), ("speed gain", False)])
def test_the_stage_writes_a_corrected_robot(tmp_path, kind, heading):
    first, second = produce(tmp_path / "data", kind, 3, heading, seconds=12.0)
    if heading:
        jumps = np.abs(np.diff(np.loadtxt(first, delimiter=",", skiprows=1)[:, 3]))
        assert jumps.max() > np.pi  # wrapped, or this would test less than it says
    out = tmp_path / "found"
    stage.run(CASE, [first, second], out)
    sealed = json.loads((tmp_path / "data" / "sealed.json").read_text())
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "attributed"
    (effect,) = document["effects"]
    assert [[effect["name"], effect["on"]]] == sealed["effects"]
    corrected = load_case(out / "corrected_case.yaml")
    (added,) = corrected.plant.effects
    assert [added.name, added.on] == sealed["effects"][0]
    assert corrected.simulator.effects == (added,)
