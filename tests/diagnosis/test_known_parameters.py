"""Parameters that are not in doubt: no error of theirs is sought, and a name that is none is refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.config.load import parse_case
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.scoring import barred
from simgap.effects import EFFECTS
from simgap.errors import UserError
from simgap.plants.plant_model import PlantModel
from simgap.stages.check import run as check
from tests.diagnosis.plants import block
from tests.stages import diagnosis_example as example


def heavier(seed):
    """The bench with a weight that is 8 % larger than declared."""
    t, rng = np.arange(2400) / 100.0, np.random.default_rng(seed)
    u = example.torque(t)
    x, states = np.array([0.4, 0.0]), []
    for k in range(t.size):
        states.append(x.copy())
        for _ in range(50):
            x[1] += 2e-4 * (u[k] - 1.08 * example.WEIGHT * np.sin(x[0])) / example.INERTIA
            x[0] += 2e-4 * x[1]
    y = np.array(states) + example.SIGMA * rng.standard_normal((t.size, 2))
    return Record((Trace("bench", t, y, u[:, None]),), ("q", "v"), ("u",))


def test_a_parameter_that_is_known_is_not_blamed():
    model = PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path()).corrected
    data = heavier(1)
    effects = ("parameter_error", "viscous_friction")
    free = diagnose(model, data, DiagnosisSettings(effects=effects))
    assert [(e.name, e.on) for e in free.effects] == [("parameter_error", "w")]
    held = diagnose(model, data, DiagnosisSettings(effects=effects, known=("w",)))
    assert ("parameter_error", "w") not in [(e.name, e.on) for e in held.effects]
    assert held.verdict != "attributed"
    (told,) = [c for c in held.candidates if (c.name, c.on) == ("parameter_error", "w")]
    assert "measured.known" in told.rejected


def test_a_name_that_is_no_parameter_is_refused(tmp_path):
    case = tmp_path / "case.yaml"
    case.write_text(example.CASE + "measured: {known: [w, weight]}\n")
    with pytest.raises(UserError, match="no parameter 'weight'") as refused:
        check(case)
    assert refused.value.key == "measured.known.1"
    assert "w, J" in str(refused.value.remedy)


def test_no_rotor_is_blamed_where_nothing_is_commanded():
    model, t = block(), np.arange(100) / 100.0
    still, moved = (Record((Trace("run", t, t[:, None], u * t[:, None]),), ("q",), ("u",)) for u in (0.0, 1.0))
    assert barred(model, still, ()) == {("reflected_inertia", "slide"): "nothing drives the plant"}
    assert barred(model, moved, ()) == {}
    assert barred(model, still, ("reflected_inertia",)) == {}


@pytest.mark.parametrize(("measured", "speed", "turns"), [("v", 2.0, True), ("v", 0.2, False), ("q", 2.0, True)])
def test_a_joint_that_turns_has_no_spring_whether_its_angle_or_its_speed_is_read(measured, speed, turns):
    model = PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path()).corrected
    t = np.arange(1000) / 100.0
    y = np.full(t.size, speed) if measured == "v" else speed * t
    out = barred(model, Record((Trace("run", t, y[:, None], np.ones((t.size, 1))),), (measured,), ("u",)), ())
    assert {name for name, _ in out} == ({e.name for e in EFFECTS.values() if e.pulls_to_a_place} if turns else set())
