"""A sampling time that crosses all of X, and parameters in other units, are told by `simgap check`."""

from __future__ import annotations

import re

import pytest
import sympy as sp
import yaml

from simgap.errors import UserError
from simgap.lint.equations import (
    find_long_steps,
    find_mixed_units,
    find_wrong_dimensions,
    rate_mismatch,
    refuse_prefixes,
)
from simgap.plants.context import Context
from simgap.units import dimension
from tests.little_cart import CASE, write_cart


@pytest.mark.parametrize("integrator", ["rk4", "explicit_euler"])
def test_forgotten_milliseconds_are_told(vary, integrator):
    """One map of 20 s moves by 11 times the width of X, the other, which steps outside X, by 26,000 times."""
    assert (
        list(find_long_steps(Context.load(vary("dc_motor", {"domain.tau": "20 ms", "plant.integrator": integrator}))))
        == []
    )
    context = Context.load(vary("dc_motor", {"domain.tau": "20 s", "plant.integrator": integrator}))
    if integrator == "rk4":
        with pytest.raises(UserError, match="times the width of X") as refused:
            list(find_long_steps(context))
        assert refused.value.key == "domain.tau"
        return
    findings = list(find_long_steps(context))
    assert [finding.key for finding in findings] == ["domain.tau", "domain.tau"]
    assert all("times the width of X" in finding.problem for finding in findings)


def test_inputs_in_another_unit_are_refused(vary):
    """Millivolts for volts: thousandfold currents, hundreds of X in one step."""
    volts = {"min": 0, "max": 12_000_000, "step": 2_000_000}
    with pytest.raises(UserError, match="times the width of X") as refused:
        list(find_long_steps(Context.load(vary("dc_motor", {"domain.U.V": volts}))))
    assert refused.value.key == "domain.tau"
    assert "units" in refused.value.remedy


def test_an_inductance_in_another_unit_is_told(vary):
    key = "plant.symbolic.parameters.L.value"
    (finding,) = find_long_steps(Context.load(vary("dc_motor", {key: 500})))
    assert finding.key == "domain.tau"
    assert "i moves by at most" in finding.problem
    with pytest.raises(UserError, match="times the width of X"):
        list(find_long_steps(Context.load(vary("dc_motor", {key: 5e-6}))))


def test_no_case_that_ships_is_told(root):
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        context = Context.load(path)
        if context.case.domain is not None and context.case.plant.urdf is None:
            assert list(find_long_steps(context)) == [], path


def test_a_parameter_in_another_unit_is_told_with_its_number_in_si(vary):
    path = vary("dc_motor", {"plant.symbolic.parameters.J.unit": "lb*m^2", "plant.symbolic.parameters.J.value": 100})
    (finding,) = find_mixed_units(Context.load(path))
    assert finding.key == "plant.symbolic.parameters.J"
    assert finding.remedy.endswith(": 45.3592")
    assert list(find_mixed_units(Context.load(vary("dc_motor", {})))) == []


@pytest.mark.parametrize(
    ("key", "unit"),
    [("plant.inputs.V", "mV"), ("plant.states.i", "mA"), ("plant.symbolic.parameters.J", "g*m^2"),
     ("plant.symbolic.parameters.R", "kohm")],
)  # fmt: skip
def test_a_prefix_beside_si_is_refused(vary, key, unit):
    with pytest.raises(UserError, match="a factor of 1000 is lost") as refused:
        refuse_prefixes(Context.load(vary("dc_motor", {f"{key}.unit": unit})))
    assert refused.value.key == f"{key}.unit"


def test_units_with_prefixes_that_make_one_system_are_no_mistake(vary):
    """A cart in millimetres, kilograms and millinewtons: F = m a holds in their numbers."""
    plant = {
        "states": {"x": {"unit": "mm"}, "v": {"unit": "mm/s"}},
        "inputs": {"F": {"unit": "mN"}},
        "symbolic": {"parameters": {"m": {"value": 2, "unit": "kg"}}, "dynamics": {"x": "v", "v": "F/m"}},
    }
    refuse_prefixes(Context.load(_alone(vary, plant)))
    plant["inputs"]["F"]["unit"] = "N"
    with pytest.raises(UserError, match="beside units of another size"):
        refuse_prefixes(Context.load(_alone(vary, plant)))


def _alone(vary, plant):
    path = vary("dc_motor", {})
    path.write_text(yaml.safe_dump({"name": path.stem, "plant": plant}, sort_keys=False))
    return path


def test_no_case_that_ships_mixes_prefixes(root):
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        refuse_prefixes(Context.load(path))


def test_an_inductance_in_ohm_is_told_at_its_equation(vary):
    path = vary("dc_motor", {"plant.symbolic.parameters.R.unit": "H"})
    found = list(find_wrong_dimensions(Context.load(path)))
    assert found
    assert all(f.key.startswith("plant.symbolic.dynamics.") for f in found)
    assert any("adds" in f.problem for f in found)


def test_no_equation_that_ships_is_told(root):
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        assert list(find_wrong_dimensions(Context.load(path))) == [], path


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("v/L", ""), ("(u + i)/L", "adds"), ("sin(v)", "sin(v) is taken of"), ("9.81*i", ""), ("sin(3.5*v)*i/T", ""),
        ("v", "gives"), ("Abs(i)/T + Max(i, 2*i, 0)/T", ""), ("tanh(i/(2*i))*i/T", ""), ("i**2", "gives A^2"),
    ],
)  # fmt: skip
def test_dimensions_of_a_rate(text, wrong):
    units = {"i": "A", "u": "V", "v": "V", "L": "H", "T": "s"}
    expr = sp.sympify(text, locals={name: sp.Symbol(name) for name in units})
    told = rate_mismatch(expr, "A", {name: dimension(unit) for name, unit in units.items()})
    assert told.startswith(wrong) if wrong else told == ""


def test_a_mass_or_an_inertia_below_zero_is_refused(tmp_path):
    def loaded(value, unit):
        plant = {"symbolic": {"parameters": {"J": {"value": value, "unit": unit}}, "dynamics": {"x": "v", "v": "F/J"}}}
        return Context.load(write_cart(tmp_path, plant=CASE["plant"] | plant)).plant.declared

    for unit in ("kg*m^2", "g", "g*cm^2"):
        with pytest.raises(UserError, match=f"-0.1 {re.escape(unit)} is negative") as refused:
            loaded(-0.1, unit)
        assert refused.value.key == "plant.symbolic.parameters.J.value"
    assert loaded(0.1, "kg").parameters["J"].value == 0.1
    assert loaded(-0.1, "N").parameters["J"].value == -0.1
