"""Equations that are written out give what Drake computes from the same file, whatever its axes and inertias."""

import numpy as np
import pytest
import sympy as sp

from simgap.config.plant import Input, State
from simgap.model.symbolic import symbol
from simgap.plants.drake_check import accelerations
from simgap.plants.urdf import load_urdf, multibody_plant

LINK = """<link name="{name}"><inertial><origin xyz="0.03 -0.05 0.2" rpy="0.3 -0.2 0.9"/><mass value="{m}"/>
  <inertia ixx="0.3" ixy="0.02" ixz="-0.01" iyy="0.25" iyz="0.03" izz="0.2"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{up}"/><child link="{down}"/>
  <origin xyz="0.1 0.2 0.3" rpy="{rpy}"/><axis xyz="{axis}"/>{more}</joint>"""
STOPS = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
STATES = {
    f"{letter}{k}": State(joint=f"j{k}", quantity=kind, unit="rad")
    for letter, kind in (("q", "position"), ("v", "velocity"))
    for k in (1, 2)
}


def arm(folder, kinds, axes, rpy="0 0 0"):
    """Two joints and links, nothing of which is along an axis."""
    parts = [
        '<link name="world"/>',
        LINK.format(name="a", m=2.0),
        LINK.format(name="b", m=1.5),
        JOINT.format(name="j1", kind=kinds[0], up="world", down="a", rpy=rpy, axis=axes[0], more=STOPS),
        JOINT.format(name="j2", kind=kinds[1], up="a", down="b", rpy="-0.7 0.2 1.1", axis=axes[1], more=STOPS),
    ]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return path


@pytest.mark.parametrize("kinds", [("revolute", "revolute"), ("prismatic", "revolute")])
def test_an_arm_that_is_nowhere_along_an_axis_moves_as_drake_says(tmp_path, kinds):
    path = arm(tmp_path, kinds, ("0.6 0 0.8", "0.48 0.64 0.6"), rpy="0.5 0.6 0.7")
    model = load_urdf(path, STATES, {"u1": Input(joint="j1", unit="N*m"), "u2": Input(joint="j2", unit="N*m")})
    rates = sp.lambdify([symbol(n) for n in (*STATES, "u1", "u2")], model.numeric())
    plant, _ = multibody_plant(path, (0.0, 0.0, -9.81))
    rng = np.random.default_rng(1)
    for x, u in zip(rng.uniform(-1, 1, (5, 4)), rng.uniform(-3, 3, (5, 2)), strict=True):
        expected = accelerations(plant, (0, 1), x[None, :2], x[None, 2:], u[None])[0]
        np.testing.assert_allclose(rates(*x, *u)[2:], expected, rtol=1e-9)


def test_a_vertical_first_axis_leaves_no_position_of_it_in_the_equations(tmp_path):
    path = arm(tmp_path, ("revolute", "revolute"), ("0 0 1", "0.48 0.64 0.6"), rpy="0 0 0.7")
    model = load_urdf(path, STATES, {"u1": Input(joint="j1", unit="N*m"), "u2": Input(joint="j2", unit="N*m")})
    assert not any(symbol("q1") in sp.expand(e).free_symbols for e in model.numeric()[2:])
