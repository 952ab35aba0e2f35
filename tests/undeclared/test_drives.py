"""What drives do that textbooks leave out, hidden in an arm and in a slide: named, with their numbers."""

from __future__ import annotations

import pytest
import sympy as sp

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol
from tests.undeclared.rig import drives

JOINTS = {"arm": (0.25, 1.5), "slide": (2.0, 0.0)}  # inertia, weight times lever


def joint(name: str) -> SymbolicModel:
    """As declared: J a = u - w sin(q), no friction; no named parameters, so that no other effect is the same."""
    inertia, weight = (symbol(n) for n in ("J", "w"))
    declared = JOINTS[name]
    return SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")),
        inputs=(Variable("u", "N*m"),),
        parameters={"J": Parameter(declared[0], "kg*m^2"), "w": Parameter(declared[1], "N*m")},
        xdot=(symbol("v"), (symbol("u") - weight * sp.sin(symbol("q"))) / inertia),
        coordinates=(Coordinate("axis", "q", "v"),),
        force_map={"axis": (sp.Integer(0), 1 / inertia)},
    )


def diagnosed(name: str, hidden: dict[str, float], seed: int, effects: tuple[str, ...] = ()):
    data = drives.record(*JOINTS[name], hidden, seed)
    traces = tuple(Trace(f"run{k}", *run) for k, run in enumerate(data))
    return diagnose(joint(name), Record(traces, ("q",), ("u",)), DiagnosisSettings(effects=effects))


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
