"""A unit of a case is either right or refused in one line that names its key."""

import math
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.plant import PlantSection
from simgap.effects import EFFECTS
from simgap.errors import UserError
from simgap.plants.plant_model import PlantModel
from simgap.simulators.joints import joint_plant
from simgap.units import conversion

ROD = {
    "symbolic": {
        "parameters": {"I": {"value": 0.5, "unit": "kg*m^2"}},
        "dynamics": {"q": "v", "v": "u/I"},
        "coordinates": {"hinge": {"position": "q", "velocity": "v", "force_gain": "1/I"}},
    },
    "states": {"q": {"unit": "rad"}, "v": {"unit": "rad/s"}},
    "inputs": {"u": {"unit": "N*m"}},
}


def equations(q="rad", v="rad/s", u="N*m", force="N*m", inertia="kg*m^2"):
    section = PlantSection.model_validate(ROD).model_dump()
    section["states"]["q"]["unit"], section["states"]["v"]["unit"], section["inputs"]["u"]["unit"] = q, v, u
    section["symbolic"]["coordinates"]["hinge"]["force_unit"] = force
    section["symbolic"]["parameters"]["I"]["unit"] = inertia
    return PlantModel(PlantSection.model_validate(section), Path())


@pytest.mark.parametrize(
    ("key", "unit", "wanted"),
    [
        ("plant.states.x1.unit", "deg", "rad"),
        ("plant.states.x1.unit", "mm", "rad"),
        ("plant.states.x2.unit", "deg/s", "rad/s"),
        ("plant.states.x2.unit", "rpm", "rad/s"),
        ("plant.states.x2.unit", "Hz", "rad/s"),
        ("plant.inputs.u.unit", "N*cm", "N*m"),
        ("plant.inputs.u.unit", "N", "N*m"),
        ("plant.inputs.u.unit", "rpm", "N*m"),
    ],
)
def test_a_joint_is_in_si(vary, key, unit, wanted):
    path = vary("pendulum", {key: unit})
    with pytest.raises(UserError) as caught:
        _ = PlantModel.of(load_case(path), path.parent).declared
    assert caught.value.key == key
    assert f"'{unit}'" in str(caught.value)
    assert f"Use '{wanted}'" in str(caught.value)


def test_equations_whose_joint_an_engine_drives_are_in_its_units(vary, root):
    """The engine takes the numbers as they are: degrees would be read as radians."""
    symbolic = {"parameters": {}, "dynamics": {"x1": "x2", "x2": "u"}}
    urdf = str(root / "configs" / "models" / "pendulum.urdf")
    changes = {"plant.symbolic": symbolic, "plant.integrator": "explicit_euler", "simulator.urdf": urdf}
    for key, unit in (
        ("plant.states.x1.unit", "deg"),
        ("plant.inputs.u.unit", "N*cm"),
        ("plant.states.x2.unit", "rpm"),
    ):
        path = vary("pendulum", {**changes, key: unit}, remove=("plant.urdf",))
        with pytest.raises(UserError) as caught:
            joint_plant(load_case(path), path.parent)
        assert caught.value.key == key
    path = vary("pendulum", changes, remove=("plant.urdf",))
    assert joint_plant(load_case(path), path.parent).joints == ("hinge",)


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("plant.states.theta.unit", "deg"), ("plant.states.x.unit", "mm"),
        ("plant.inputs.w.unit", "rpm"), ("plant.inputs.v.unit", "mm/s"),
    ],
)  # fmt: skip
def test_the_roles_of_a_wheeled_robot_are_in_si(vary, key, unit):
    path = vary("turtlebot", {key: unit})
    with pytest.raises(UserError) as caught:
        _ = PlantModel.of(load_case(path), path.parent).declared
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"q": "radd"}, "plant.states.q.unit"),
        ({"u": "Nm2x"}, "plant.inputs.u.unit"),
        ({"force": "newtonn"}, "plant.symbolic.coordinates.hinge.force_unit"),
        ({"inertia": "kgg"}, "plant.symbolic.parameters.I.unit"),
        ({"q": "deg"}, "plant.states.v.unit"),  # a velocity in rad/s of a position in deg
        ({"v": "rpm"}, "plant.states.v.unit"),
    ],
)
def test_units_of_equations_exist_and_a_velocity_is_that_of_its_position(given, key):
    with pytest.raises(UserError) as caught:
        _ = equations(**given).declared
    assert caught.value.key == key


def test_parameters_of_an_effect_are_in_the_units_of_the_equations():
    model = equations(q="deg", v="deg/s", u="N*cm", force="N*cm").declared
    assert EFFECTS["spring"].units(model, "hinge")["k"] == "N*cm/deg"
    assert EFFECTS["viscous_friction"].units(model, "hinge")["b"] == "N*cm*s/deg"
    assert EFFECTS["input_bias"].units(model, "u")["bias"] == "N*cm"
    in_si = equations(force="N*cm", u="N*cm").declared  # a torque in N*cm turns a joint in rad, it pushes nothing in m
    assert EFFECTS["spring"].units(in_si, "hinge")["k"] == "N*cm/rad"


def test_a_carried_lag_has_the_unit_of_its_input(vary):
    lag = {"name": "input_lag", "on": "u", "parameters": {"T": 0.03}}
    state = {"plant.states.u_lagged": {"unit": "N*cm", "lag_of": "u"}, "domain.X.u_lagged": [-120.0, 120.0]}
    path = vary("pendulum", {"plant.effects": [lag], **state})
    with pytest.raises(UserError) as caught:
        _ = PlantModel.of(load_case(path), path.parent).carried
    assert caught.value.key == "plant.states.u_lagged.unit"


@pytest.mark.parametrize(
    ("cell", "state", "factor"),
    [
        ("N*cm", "N*m", 0.01), ("rpm", "rad/s", math.pi / 30), ("deg/s", "rad/s", math.pi / 180), ("mm", "m", 1e-3),
        ("deg", "rad", math.pi / 180), ("rpm", "deg/s", 6.0), ("turn/s", "rad/s", 2 * math.pi),
    ],
)  # fmt: skip
def test_measured_columns_are_converted(cell, state, factor):
    assert np.isclose(conversion(cell, state).factor, factor, rtol=1e-14)
    assert conversion(cell, state).shift == 0.0


def test_hertz_is_no_angular_velocity():
    """Turns a second, or radians a second? pint says the latter, an encoder's datasheet the former."""
    with pytest.raises(UserError, match="Hz"):
        conversion("Hz", "rad/s")


@pytest.mark.parametrize(
    ("position", "velocity", "force", "viscous", "spring"),
    [
        ("m", "m/s", "N", "N*s/m", "N/m"), ("mm", "mm/s", "N", "N*s/mm", "N/mm"),
        ("rad", "rad/s", "N*m", "N*m*s/rad", "N*m/rad"), ("deg", "deg/s", "N*m", "N*m*s/deg", "N*m/deg"),
    ],
)  # fmt: skip
def test_a_force_that_the_case_gives_no_unit_is_in_that_of_its_coordinate(position, velocity, force, viscous, spring):
    """N along a length, N m about an angle: everything that is printed of an effect has its unit from here."""
    model = equations(q=position, v=velocity, force=None).declared
    assert EFFECTS["coulomb_friction"].units(model, "hinge")["F_c"] == force
    assert EFFECTS["viscous_friction"].units(model, "hinge")["b"] == viscous
    assert EFFECTS["spring"].units(model, "hinge")["k"] == spring


def test_a_force_on_a_coordinate_of_another_kind_makes_an_energy_with_it():
    """A charge and its current: the force is a voltage, N m/C."""
    model = equations(q="coulomb", v="coulomb/s", force=None).declared
    assert conversion(model.coordinate("hinge").force_unit, "V").factor == pytest.approx(1.0)


def test_damping_that_a_model_file_declares_on_a_slide_is_that_of_a_force(root, tmp_path):
    text = (root / "configs/models/cart_pole.urdf").read_text()
    (tmp_path / "m.urdf").write_text(text.replace('damping="0.0"', 'damping="0.3"', 1))  # the rail stands first
    states = {
        f"{kind[0]}{joint}": {"unit": unit + end, "joint": joint, "quantity": kind}
        for joint, unit in (("rail", "m"), ("hinge", "rad"))
        for kind, end in (("position", ""), ("velocity", "/s"))
    }
    section = {"urdf": "m.urdf", "states": states}
    model = PlantModel(PlantSection.model_validate(section), tmp_path).declared
    assert model.parameters["rail.damping"].unit == "N*s/m"
    assert EFFECTS["viscous_friction"].units(model, "rail")["b"] == "N*s/m"
    assert EFFECTS["viscous_friction"].units(model, "hinge")["b"] == "N*m*s/rad"
