"""The staircase of an engine that a force makes which turns round at the end of engine steps."""

import numpy as np
import pytest
import yaml

from simgap.gap.fitting.force_reversal import kick, staircase_height, staircase_tier
from simgap.plants.context import Context
from simgap.simulators.rollouts import make_simulator

MASS, FRICTION, TAU = 2.0, 0.6, 0.1
PYBULLET = {"engine": "pybullet", "inertia": "file", "damping": {"linear": 0, "angular": 0, "joint": 0}}
RUBS = {"name": "coulomb_friction", "on": "rail", "parameters": {"F_c": FRICTION}}


def climbed(context, force=3.0, length=0.4, points=4001):
    """The largest jumps of the gap on a fine line of speeds below rest, by the simulator's own successors."""
    speeds = np.linspace(-length, -1e-6, points)
    x = np.stack([np.zeros_like(speeds), speeds], axis=1)
    u = np.full((len(x), 1), force)
    gap = make_simulator(context.case, context.folder).rollouts(x, u) - context.plant.sampled.step(x, u)
    return np.abs(np.diff(gap, axis=0)).max(axis=0)


def urdf(mass):
    return f"""<robot name="slide"><link name="world"/><link name="mass"><inertial>
        <mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="rail" type="prismatic"><parent link="world"/><child link="mass"/><axis xyz="1 0 0"/>
        <limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>"""


def slide(folder, substeps, effect="coulomb_friction", values=None, nominal=(), **simulator):
    """A mass on a rail, by URDF, with a friction that the simulator has, and the model if `nominal` says so."""
    (folder / "slide.urdf").write_text(urdf(MASS))
    (folder / "light.urdf").write_text(urdf(MASS / 4))
    case = {
        "name": "slide",
        "plant": {
            "urdf": "slide.urdf", "integrator": "semi_implicit_euler", "effects": list(nominal),
            "states": {
                "q": {"joint": "rail", "quantity": "position", "unit": "m"},
                "v": {"joint": "rail", "quantity": "velocity", "unit": "m/s"},
            },
            "inputs": {"u": {"joint": "rail", "unit": "N"}},
        },
        "domain": {"tau": TAU, "X": {"q": [-1, 1], "v": [-1, 1]}, "U": {"u": {"values": [-3, 0, 3]}}},
        "simulator": {
            "substeps": substeps,
            "effects": [{"name": effect, "on": "rail", "parameters": values or {"F_c": FRICTION}}],
        } | (simulator or PYBULLET),
    }  # fmt: skip
    path = folder / "slide.yaml"
    path.write_text(yaml.safe_dump(case))
    return Context.load(path)


@pytest.mark.parametrize("substeps", [4, 24])
def test_it_is_the_height_of_the_stairs_that_the_engine_climbs(tmp_path, substeps):
    context = slide(tmp_path, substeps)
    q, v = staircase_height(context)
    assert v == pytest.approx(2 * FRICTION / MASS * TAU / substeps, rel=0.02)
    assert kick(context) == pytest.approx([0.0, 2 * FRICTION / MASS * TAU / substeps])
    jumps = climbed(context)
    assert v == pytest.approx(jumps[1], rel=0.05)
    assert jumps[0] <= q * 1.05
    assert f"{v:.2g} for v" in staircase_tier(context, np.array([q, v])).text


def test_a_lighter_mass_in_the_simulator_and_what_its_integrator_does_are_measured(tmp_path):
    """The rates of the nominal plant know neither; four times the kick, and a step that looks at its middle."""
    light = slide(tmp_path, 24, **PYBULLET, urdf="light.urdf")
    assert staircase_height(light)[1] == pytest.approx(4 * kick(light)[1], rel=0.05)
    assert staircase_height(light)[1] >= 0.95 * climbed(light)[1]
    looks = slide(tmp_path, 1, engine="equations", integrator="rk4", slopes="sampled")
    assert kick(looks)[1] == 0.0
    assert climbed(looks)[1] > 0.01
    assert staircase_height(looks)[1] >= 0.95 * climbed(looks)[1]


def test_a_model_that_rubs_as_well_adds_no_more_than_the_stairs(tmp_path):
    both = slide(tmp_path, 24, nominal=[RUBS])
    assert staircase_height(both)[1] == pytest.approx(kick(both)[1], rel=0.1)


def test_nothing_is_added_where_nothing_turns_round_within_a_step(tmp_path):
    assert staircase_height(slide(tmp_path, 1)) is None
    assert staircase_height(slide(tmp_path, 24, effect="viscous_friction", values={"b": 0.3})) is None
    assert staircase_height(slide(tmp_path, 24, values={"F_c": 0.0})) is None


def test_a_stair_of_faint_friction_is_added_too(tmp_path):
    """Of 1e-4 N m on a cube 110 of 50,000 steps were outside gamma, by a stair of 1e-7 of X that counted as nothing."""
    context = slide(tmp_path, 16, values={"F_c": 1e-5})
    q, v = staircase_height(context)
    jumps = climbed(context)
    assert 0.0 < v < 1e-6 * 2.0
    assert v >= 0.95 * jumps[1]
    assert q >= 0.95 * (jumps[0] - 1e-12)
