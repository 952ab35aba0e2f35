"""`simgap check` lets a wheeled robot drive and turn: spoilt files are told, with the part that is wrong."""

from pathlib import Path

import pytest
import yaml

from simgap.errors import UserError
from simgap.lint.engine import model_file, of_engine
from simgap.plants.context import Context

ROOT = Path(__file__).parents[2]
TYRE = '<collision><geometry><sphere radius="0.0975"/></geometry></collision>'
AXIS, FRICTION = '<axis xyz="0 1 0"/>', '<lateral_friction value="1.0"/>'
CENTRE = '<origin xyz="-0.06 0 0.045" rpy="0 0 0"/>'


def robot(tmp_path, engine="pybullet_wheeled", spoil=None, U=None, **keys):
    """The case of the Pioneer with parts of its file and keys of its simulator changed: what `check` asks of it."""
    text = (ROOT / "configs/models/pioneer.urdf").read_text()
    for old, new, count in spoil or ():
        assert old in text
        text = text.replace(old, new, count)
    (tmp_path / "robot.urdf").write_text(text)
    case = yaml.safe_load((ROOT / "configs/cases/pioneer.yaml").read_text())
    case["domain"]["U"] = U or case["domain"]["U"]
    case["simulator"].update({"urdf": "robot.urdf", "engine": engine, **keys})
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    context = Context.load(path)
    return of_engine(context, model_file(context))[0]


def cylinder(turned):
    return TYRE.replace("<geo", f'<origin rpy="{turned} 0 0"/><geo').replace(
        '<sphere radius="0.0975"', '<cylinder radius="0.0975" length="0.03"'
    )


SPOILT = [
    ("flat", [(TYRE, cylinder(0), -1)], "link 'wheel_l': <collision><origin> rpy", "lies the wrong way"),
    ("bodiless", [(TYRE, "", -1)], "link 'wheel_l': <collision>", "The wheel has none"),
    ("upright axis", [(AXIS, '<axis xyz="0 0 1"/>', -1)], "joint 'drive_l': <axis>", "a wheel turns about its y"),
    ("along axis", [(AXIS, '<axis xyz="1 0 0"/>', -1)], "joints 'drive_l' and 'drive_r'", "drives sideways"),
    ("backwards", [(AXIS, '<axis xyz="0 -1 0"/>', -1)], "joints 'drive_l' and 'drive_r'", "drives backwards"),
    ("one backwards", [(AXIS, '<axis xyz="0 -1 0"/>', 1)], "joints 'drive_l' and 'drive_r'", "axis> of one wheel"),
    ("slippery", [(FRICTION, '<lateral_friction value="0"/>', -1)], "link 'wheel_l': <lateral_friction>", "slips"),
    ("top-heavy", [(CENTRE, '<origin xyz="0.25 0 0.045"/>', 1)], "joints 'drive_l' and 'drive_r'", "centre of mass"),
    ("hanging", [(TYRE, TYRE.replace("0.0975", "0.005"), -1)], "joints 'drive_l' and 'drive_r'", "sinks"),
    ("rubbing", [('n value="0.0"', 'n value="1.0"', -1)], "joints 'drive_l' and 'drive_r'", "a caster with friction"),
]  # fmt: skip


@pytest.mark.parametrize("engine", ["pybullet_wheeled", "mujoco_wheeled"])
@pytest.mark.parametrize(("name", "spoil", "key", "said"), SPOILT, ids=[s[0] for s in SPOILT])
def test_a_robot_that_does_not_drive_is_refused_with_the_part_that_is_wrong(tmp_path, engine, name, spoil, key, said):
    with pytest.raises(UserError, match=said) as refused:
        robot(tmp_path, engine, spoil)
    assert refused.value.key == key
    assert refused.value.remedy


def test_wheels_that_were_exchanged_are_told(tmp_path):
    with pytest.raises(UserError, match="turns the other way") as refused:
        robot(tmp_path, left="drive_r", right="drive_l")
    assert refused.value.key == "simulator.left"
    assert "left: drive_l, right: drive_r" in refused.value.remedy


@pytest.mark.parametrize("engine", ["pybullet_wheeled", "mujoco_wheeled"])
def test_what_drives_as_told_is_not_told(tmp_path, engine):
    assert robot(tmp_path, engine) == []
    late = [{"name": "input_delay", "on": "v", "parameters": {"delay": 0.9}}]
    late += [{"name": "input_gain", "on": "v", "parameters": {"ratio": 0.5}}]
    assert robot(tmp_path, engine, effects=late) == []  # effects that are declared are no fault of the file


@pytest.mark.parametrize(
    ("keys", "key"),
    [({"wheel_radius": 0.117}, "simulator.wheel_radius"), ({"torque": 0.03}, "simulator.torque")],
)
def test_a_robot_that_is_slower_than_told_is_said(tmp_path, keys, key):
    found = robot(tmp_path, **keys)
    assert key in {finding.key for finding in found}


@pytest.mark.parametrize("rate", [1.0, 1.8])
def test_a_robot_that_can_only_turn_as_it_drives_is_no_fault(tmp_path, rate):
    """Its straightest command is an arc: the chord of a step leans to one side and is short, the body does not."""
    assert robot(tmp_path, U={"v": {"values": [0.4]}, "w": {"values": [-rate, rate]}}) == []


def test_a_wheel_that_is_smaller_than_the_other_is_told(tmp_path):
    (found,) = robot(tmp_path, spoil=[(TYRE, TYRE.replace("0.0975", "0.083"), 1)])
    assert "pulls to one side" in found.problem
