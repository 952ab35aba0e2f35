"""What drives do that textbooks leave out, hidden in an arm and in a slide: named, with their numbers."""

from __future__ import annotations

import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from tests.undeclared.joints import joint, record


def diagnosed(name: str, hidden: dict[str, float], seed: int, effects: tuple[str, ...] = ()):
    return diagnose(joint(name), record(name, hidden, seed), DiagnosisSettings(effects=effects))


@pytest.mark.parametrize(
    ("plant", "name", "hidden"),
    [
        ("arm", "dahl_friction", {"F_c": 0.12, "d": 0.04}),
        ("slide", "dahl_friction", {"F_c": 0.5, "d": 0.02}),
        ("arm", "reflected_inertia", {"I": 0.04}),
        ("arm", "load_friction", {"mu": 0.15}),
        ("arm", "input_directional_gain", {"ratio_p": 1.1, "ratio_m": 0.85}),
    ],
)
def test_a_drive_s_effect_is_named_with_its_numbers(plant, name, hidden):
    found = diagnosed(plant, hidden, 1)
    assert found.verdict == "attributed"
    (effect,) = found.effects
    assert effect.name == name
    for number, true in hidden.items():
        assert effect.parameters[number].value == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize(
    ("plant", "hidden", "named"),
    [
        ("motor", {"stall": 2.3, "fall": 0.26}, {"torque_speed_limit"}),
        ("arm", {"stall": 2.4, "fall": 0.24, "ratio_p": 0.9, "ratio_m": 0.9}, {"torque_speed_limit", "input_gain"}),
        ("motor", {"limit": 1.5, "viscous": 0.06}, {"input_saturation", "viscous_friction"}),
    ],
)
def test_a_motor_at_its_voltage_is_told_from_a_limit_and_from_friction(plant, hidden, named):
    """The torque-speed line by itself, behind a gain, and what resembles it."""
    found = diagnosed(plant, hidden, 3)
    assert found.verdict == "attributed"
    assert {e.name for e in found.effects} == named
    line = {"stall": "T_s", "fall": "k"}
    for e in found.effects:
        true = {line[n]: v for n, v in hidden.items() if n in line} if e.name == "torque_speed_limit" else {}
        assert {n: e.parameters[n].value for n in true} == pytest.approx(true, rel=0.03)


def test_friction_that_differs_with_direction_is_said_to_be_one_with_its_equal():
    """Coulomb friction beside a bias moves the joint in the same way: both are told."""
    tried = ("coulomb_friction", "input_bias", "viscous_friction", "input_gain")
    found = diagnosed("arm", {"F_p": 0.15, "F_m": 0.07}, 2, tried)
    assert found.verdict == "attributed"
    assert {e.name for e in found.effects} == {"coulomb_friction", "input_bias"}
    assert all((("directional_friction", "axis"),) in e.alternatives for e in found.effects)
    (other,) = [a for a in found.alternatives if a.effects[-1].name == "directional_friction"]
    assert other.exact
    assert other.effects[-1].values == pytest.approx({"F_p": 0.15, "F_m": 0.07}, abs=0.003)
