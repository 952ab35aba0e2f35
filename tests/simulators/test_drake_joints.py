"""Drake as the simulator: the step of other engines where nothing touches, its own contact where something does."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import check

ROOT = Path(__file__).parents[2]
WALL = """<?xml version="1.0"?>
<robot name="bumper">
  <link name="base"/>
  <joint name="stands" type="fixed"><parent link="base"/><child link="wall"/></joint>
  <link name="wall">
    <collision><origin xyz="0.3 0 0"/><geometry><box size="0.1 1 1"/></geometry></collision>
  </link>
  <joint name="rail" type="prismatic">
    <parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-0.4" upper="5" effort="100" velocity="100"/>
  </joint>
  <link name="cart">
    <inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    {shape}
  </link>
</robot>
"""
BALL = "<collision><geometry><sphere radius='0.05'/></geometry></collision>"


def rolled(path, x, u):
    ((following, engine),) = run_in_processes(roll_out, [(load_case(path), path.parent, np.array(x), np.array(u))])
    return following, engine


def cart(tmp_path, shape=BALL, **simulator):
    """A cart that may slide 0.2 m to the left of a wall at 0.25 m, or 0.4 m to the left."""
    (tmp_path / "cart.urdf").write_text(WALL.format(shape=shape))
    states = {
        "x": {"joint": "rail", "quantity": "position", "unit": "m"},
        "v": {"joint": "rail", "quantity": "velocity", "unit": "m/s"},
    }
    content = {
        "name": "cart",
        "plant": {"urdf": "cart.urdf", "states": states, "inputs": {"F": {"joint": "rail", "unit": "N"}}},
        "domain": {"tau": 0.5, "X": {"x": [-0.5, 0.5], "v": [-1, 1]}, "U": {"F": {"values": [-2, 0, 2]}}},
        "simulator": {"engine": "drake", "substeps": 500} | simulator,
    }
    (tmp_path / "cart.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return tmp_path / "cart.yaml"


@pytest.mark.parametrize("name", ["two_link", "cart_pole"])
def test_it_makes_the_step_of_pybullet_where_nothing_damps_or_touches(vary, name):
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-0.5, 0.5, (10, 4)), rng.uniform(-0.2, 0.2, (10, 2 if name == "two_link" else 1))
    drake = vary(name, {"simulator": {"engine": "drake", "substeps": 24}})
    found, engine = rolled(drake, x, u)
    assert engine.startswith("drake 1.")
    order = rng.permutation(10)
    assert np.array_equal(rolled(drake, x[order], u[order])[0], found[order])
    assert not check.run(drake).findings
    other, _ = rolled(vary(name, {}), x, u)
    assert np.abs(found - other).max() < 1e-13


def test_links_touch_what_the_file_fixes_to_the_world(tmp_path):
    (through, _), (held, _) = (
        rolled(cart(tmp_path, contact=contact), [[0.0, 1.0]], [[0.0]]) for contact in (False, True)
    )
    assert through[0] == pytest.approx([0.5, 1.0], abs=1e-12)  # nothing in the way
    assert held[0, 0] < 0.21  # a ball of 5 cm before a wall at 25 cm
    assert held[0, 1] < 0.1
    free, _ = rolled(cart(tmp_path, shape=""), [[0.0, 1.0]], [[0.0]])
    assert free[0] == pytest.approx(through[0])


def test_a_joint_stops_at_the_end_of_its_range(tmp_path):
    found, _ = rolled(cart(tmp_path, contact=False), [[-0.3, -1.0]], [[0.0]])
    assert found[0, 0] > -0.42


def test_it_acts_friction_out(tmp_path):
    friction = [{"name": "viscous_friction", "on": "rail", "parameters": {"b": 1.5}}]
    found, _ = rolled(cart(tmp_path, contact=False, effects=friction), [[0.0, 0.8]], [[0.0]])
    assert found[0, 1] == pytest.approx(0.8 * np.exp(-1.5 / 2.0 * 0.5), rel=1e-3)
