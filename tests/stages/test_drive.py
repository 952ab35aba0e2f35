"""`simgap check` reads the wheels of a robot in its file: spoilt ones are told, with the part that is wrong."""

from pathlib import Path

import pytest
import yaml

from simgap.lint.engine import find_wheel_faults
from simgap.plants.context import Context

ROOT = Path(__file__).parents[2]
TYRE = '<collision><geometry><sphere radius="0.0975"/></geometry></collision>'
AXIS, FRICTION = '<axis xyz="0 1 0"/>', '<lateral_friction value="1.0"/>'


def faults(tmp_path, spoil=None, **keys):
    """Faults of the Pioneer with parts of its file and keys of its simulator changed: key and remedy of each."""
    text = (ROOT / "configs/models/pioneer.urdf").read_text()
    for old, new, count in spoil or ():
        assert old in text
        text = text.replace(old, new, count)
    (tmp_path / "robot.urdf").write_text(text)
    case = yaml.safe_load((ROOT / "configs/cases/pioneer.yaml").read_text())
    case["simulator"].update({"urdf": "robot.urdf", **keys})
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    return {finding.key: finding.remedy for finding in find_wheel_faults(Context.load(path))}


def cylinder(turned):
    return TYRE.replace("<geo", f'<origin rpy="{turned} 0 0"/><geo').replace(
        '<sphere radius="0.0975"', '<cylinder radius="0.0975" length="0.03"'
    )


SPOILT = [
    ("flat", [(TYRE, cylinder(0), -1)], "link 'wheel_{}': <collision><origin> rpy", "lies the wrong way"),
    ("bodiless", [(TYRE, "", -1)], "link 'wheel_{}': <collision>", "The wheel has none"),
    ("upright axis", [(AXIS, '<axis xyz="0 0 1"/>', -1)], "joint 'drive_{}': <axis>", "a wheel turns about its y"),
    ("along axis", [(AXIS, '<axis xyz="1 0 0"/>', -1)], "joint 'drive_{}': <axis>", "a wheel turns about its y"),
    ("backwards", [(AXIS, '<axis xyz="0 -1 0"/>', -1)], "joint 'drive_{}': <axis>", "a wheel turns about its y"),
    ("slippery", [(FRICTION, '<lateral_friction value="0"/>', -1)], "link 'wheel_{}': <lateral_friction>", "slips"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "key", "said"), SPOILT, ids=[s[0] for s in SPOILT])
def test_wheels_that_do_not_roll_are_told_with_the_part_that_is_wrong(tmp_path, name, spoil, key, said):
    found = faults(tmp_path, spoil)
    assert list(found) == [key.format("l"), key.format("r")]
    assert all(said in remedy for remedy in found.values())


def test_one_wheel_that_turns_the_other_way_is_told(tmp_path):
    assert list(faults(tmp_path, [(AXIS, '<axis xyz="0 -1 0"/>', 1)])) == ["joint 'drive_l': <axis>"]


def test_wheels_that_were_exchanged_are_told(tmp_path):
    found = faults(tmp_path, left="drive_r", right="drive_l")
    assert found == {"simulator.left": "Exchange them: left: drive_l, right: drive_r"}


@pytest.mark.parametrize("name", ["turtlebot", "pioneer", "courier"])
def test_wheels_of_the_shipped_robots_are_no_fault(name):
    assert list(find_wheel_faults(Context.load(ROOT / f"configs/cases/{name}.yaml"))) == []


def test_a_cylinder_along_its_axis_is_no_fault(tmp_path):
    assert faults(tmp_path, [(TYRE, cylinder(1.5707963), -1)]) == {}
