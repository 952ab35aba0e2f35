"""The grain of an engine: the staircase that a force makes which turns round at the end of engine steps."""

import numpy as np
import pytest
import yaml

from simgap.gap.grain import engine_grain, grain_tier
from simgap.simulators.build import make_simulator
from simgap.stages.context import Context

MASS, FRICTION, TAU = 2.0, 0.6, 0.1


def slide(folder, substeps, engine="pybullet", effect="coulomb_friction", values=None):
    """A mass on a rail, by URDF, with a friction that the simulator alone has."""
    (folder / "slide.urdf").write_text(f"""<robot name="slide"><link name="world"/><link name="mass"><inertial>
        <mass value="{MASS}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="rail" type="prismatic"><parent link="world"/><child link="mass"/><axis xyz="1 0 0"/>
        <limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>""")
    case = {
        "name": "slide",
        "plant": {
            "urdf": "slide.urdf", "integrator": "semi_implicit_euler",
            "states": {
                "q": {"joint": "rail", "quantity": "position", "unit": "m"},
                "v": {"joint": "rail", "quantity": "velocity", "unit": "m/s"},
            },
            "inputs": {"u": {"joint": "rail", "unit": "N"}},
        },
        "domain": {"tau": TAU, "X": {"q": [-1, 1], "v": [-1, 1]}, "U": {"u": {"values": [-3, 0, 3]}}},
        "simulator": {
            "engine": engine, "substeps": substeps,
            "effects": [{"name": effect, "on": "rail", "parameters": values or {"F_c": FRICTION}}],
        } | ({"inertia": "file", "damping": {"linear": 0, "angular": 0, "joint": 0}} if engine == "pybullet" else {}),
    }  # fmt: skip
    path = folder / "slide.yaml"
    path.write_text(yaml.safe_dump(case))
    return Context.load(path)


@pytest.mark.parametrize("substeps", [4, 24])
def test_it_is_the_height_of_the_stairs_that_the_engine_climbs(tmp_path, substeps):
    """By the engine's own successors, on speeds a hundredth of a stair apart."""
    context = slide(tmp_path, substeps)
    q, v = engine_grain(context)
    assert v == pytest.approx(2 * FRICTION / MASS * TAU / substeps, rel=1e-6)
    assert q == pytest.approx(v * TAU, rel=1e-6)
    stair = (3 - FRICTION) / MASS * TAU / substeps
    speeds = -np.arange(0.0, 4 * stair, stair / 100) - 1e-6
    x = np.stack([np.zeros_like(speeds), speeds], axis=1)
    u = np.full((len(x), 1), 3.0)
    gap = make_simulator(context.case, context.folder).rollouts(x, u) - context.plant.sampled.step(x, u)
    jumps = np.abs(np.diff(gap, axis=0)).max(axis=0)
    assert jumps[1] == pytest.approx(v, rel=0.02)
    assert jumps[0] <= q * 1.02
    assert f"{v:.2g} for v" in grain_tier(context, np.array([q, v])).text


def test_nothing_is_added_where_nothing_turns_round_within_a_step(tmp_path):
    assert engine_grain(slide(tmp_path, 1)) is None
    assert engine_grain(slide(tmp_path, 24, effect="viscous_friction", values={"b": 0.3})) is None
