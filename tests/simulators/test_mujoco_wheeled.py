"""The wheeled robot in MuJoCo: physics a person can work out, independence of order, agreement with PyBullet."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import case_content, parse_case
from simgap.errors import UserError
from simgap.extras.engines.mujoco_wheeled import MuJoCoWheeled
from simgap.simulators.pybullet import PyBulletWheeled
from simgap.simulators.wheeled import wheeled_plant
from simgap.stages import check

CASES = Path(__file__).parents[2] / "configs/cases"
MASS, WHEEL, RADIUS, TRACK, TORQUE = 9.1, 0.0033, 0.0975, 0.33, 0.6
INPUTS = np.array([[0.4, 0.0], [0.4, 0.0], [0.2, 0.9], [-0.2, 0.9], [0.0, 0.0], [0.4, -0.9]])

pytest.importorskip("mujoco")


def make(kind=MuJoCoWheeled, engine="mujoco_wheeled", **changes):
    path = CASES / "pioneer.yaml"
    content = case_content(path)
    content["simulator"] |= {"engine": engine, "substeps": 80, **changes}
    case = parse_case(content, path)
    return kind(wheeled_plant(case, CASES), case.simulator)


def test_motors_of_limited_torque_accelerate_the_robot():
    """By hand: 2 T/r move the mass and the wheels' inertia, I/r^2 each; after 0.2 s they still do.

    In steps of h, speed first, a constant acceleration a leads to a t (t + h)/2.
    """
    robot = make(substeps=320)
    robot.reset(np.zeros(3))
    robot.advance(np.array([0.4, 0.0]))
    acceleration = 2.0 * TORQUE / RADIUS / (MASS + 2.0 * WHEEL / RADIUS**2)
    t = 0.8 / 20 * np.arange(1, 6)
    np.testing.assert_allclose(robot.path[:5, 0], 0.5 * acceleration * t * (t + 0.8 / 320), rtol=0.03)
    assert np.abs(robot.path[:, 1:]).max() < 1e-9


def test_the_speeds_that_are_asked_for_are_reached():
    robot = make()
    poses, _ = robot.chain(np.zeros(3), np.array([[0.4, 0.0], [0.4, 0.0], [0.0, 0.9], [0.0, 0.9]]))
    steps = np.diff(poses, axis=0)
    assert steps[1, 0] == pytest.approx(0.4 * 0.8, rel=0.01)
    assert steps[3, 2] == pytest.approx(0.9 * 0.8, rel=0.02)


def test_where_it_stands_which_way_it_looks_and_what_ran_before_do_not_matter():
    robot = make()
    first = robot.responses(INPUTS[:3], INPUTS)
    robot.chain(np.array([3.0, 1.0, 2.0]), INPUTS[::-1])
    assert np.array_equal(robot.responses(INPUTS[:3], INPUTS), first)
    assert np.array_equal(make().responses(INPUTS[:3], INPUTS[::-1])[::-1], first)
    assert np.abs(robot.responses(INPUTS[:3], INPUTS, 1.1) - first).max() < 1e-9
    here, _ = robot.chain(np.zeros(3), INPUTS)
    there, _ = robot.chain(np.array([2.0, -1.0, 0.0]), INPUTS)
    assert np.abs(there - here - [2.0, -1.0, 0.0]).max() < 1e-9


def test_two_engines_agree_about_the_robot():
    """Nothing is shared but the file: contacts, motors and integrators are their own."""
    mine, _ = make().chain(np.array([1.0, 1.0, 0.5]), INPUTS)
    other, _ = make(PyBulletWheeled, "pybullet_wheeled", substeps=40).chain(np.array([1.0, 1.0, 0.5]), INPUTS)
    assert np.abs(mine - other)[:, :2].max() < 0.01
    assert np.abs(mine - other)[:, 2].max() < 0.02


def test_what_touches_the_floor_states_its_friction(tmp_path):
    robot = make()
    text = robot._plant.urdf.read_text()
    for wrong, said in (("", "states no friction"), ('<contact><lateral_friction value="1.5"/></contact>', "1.5")):
        (tmp_path / "m.urdf").write_text(text.replace('<contact><lateral_friction value="1.0"/></contact>', wrong, 1))
        with pytest.raises(UserError, match=said) as caught:
            MuJoCoWheeled(replace(robot._plant, urdf=tmp_path / "m.urdf"), robot._section)
        assert caught.value.key == "link 'wheel_l': <lateral_friction>"
    with pytest.raises(UserError, match="no joint called"):
        make(left="left_wheel")


def test_a_case_with_it_can_be_checked(vary, root):
    """The engine has the masses, inertias and centres of mass of the file, frames on fixed joints included."""
    urdf = str(root / "configs/models/pioneer.urdf")
    found = check.run(vary("pioneer", {"simulator.engine": "mujoco_wheeled", "simulator.urdf": urdf}))
    assert found.compared
    assert not found.findings


@pytest.mark.parametrize("engine", ["mujoco_wheeled", "pybullet_wheeled"])
def test_a_root_without_mass_is_refused_by_check(vary, root, tmp_path, engine):
    """`base_footprint` over the chassis, as ROS packages have it: PyBullet would make the robot 1 kg heavier."""
    text = (root / "configs/models/pioneer.urdf").read_text()
    footprint = """<link name="base_footprint"/><joint name="base_joint" type="fixed"><parent link="base_footprint"/>
    <child link="base"/><origin xyz="0 0 0"/></joint></robot>"""
    (tmp_path / "rover.urdf").write_text(text.replace("</robot>", footprint))
    path = vary("pioneer", {"simulator.engine": engine, "simulator.urdf": str(tmp_path / "rover.urdf")})
    with pytest.raises(UserError, match="no mass and inertia") as caught:
        check.run(path)
    assert caught.value.key == "link 'base_footprint': <inertial>"


@pytest.mark.parametrize("engine", ["mujoco_wheeled", "pybullet_wheeled"])
def test_a_wheel_that_is_no_joint_is_told_with_its_key(vary, root, engine):
    changes = {"simulator.engine": engine, "simulator.urdf": str(root / "configs/models/pioneer.urdf")}
    path = vary("pioneer", {**changes, "simulator.right": "rite_wheel"})
    said = r"simulator\.right: no joint called 'rite_wheel' in pioneer.urdf.*: drive_l, drive_r"
    with pytest.raises(UserError, match=said):
        check.run(path)


def test_a_payload_is_on_the_base():
    light, heavy = make(), make(payload=5.0)
    slower = [robot.chain(np.zeros(3), INPUTS[:1])[0][1, 0] for robot in (light, heavy)]
    assert slower[1] < slower[0] - 0.02
    assert heavy._run.model.body("base").mass[0] == pytest.approx(7.6 + 5.0)
