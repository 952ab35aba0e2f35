"""A sampling time that crosses all of X, and parameters in other units, are told by `simgap check`."""

from __future__ import annotations

import pytest

from simgap.stages.context import Context
from simgap.stages.mixed_units import mixed_units
from simgap.stages.step_length import long_steps


@pytest.mark.parametrize(("tau", "told"), [("20 ms", []), ("20 s", ["domain.tau", "domain.tau"])])
@pytest.mark.parametrize("integrator", ["rk4", "explicit_euler"])
def test_forgotten_milliseconds_are_told(vary, tau, told, integrator):
    path = vary("dc_motor", {"domain.tau": tau, "plant.integrator": integrator})
    findings = long_steps(Context.load(path))
    assert [f.key for f in findings] == told
    assert all("times the width of X" in f.problem for f in findings)


def test_no_case_that_ships_is_told(root):
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        context = Context.load(path)
        if context.case.domain is not None and context.case.plant.urdf is None:
            assert long_steps(context) == [], path


def test_a_parameter_in_grams_is_told_with_its_number_in_kilograms(vary):
    path = vary("dc_motor", {"plant.symbolic.parameters.J.unit": "g*m^2", "plant.symbolic.parameters.J.value": 100})
    (finding,) = mixed_units(Context.load(path))
    assert finding.key == "plant.symbolic.parameters.J"
    assert finding.remedy.endswith(": 0.1")
    assert mixed_units(Context.load(vary("dc_motor", {}))) == []
