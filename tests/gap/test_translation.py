"""States on which the gap does not depend: sampled by one cell, measured on shifts, refused where it is not so."""

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import BrokenPromise, UserError
from simgap.gap.checked_bound import reached_stops
from simgap.gap.sampling.borders import SHIFTED, border_gaps, border_states, parts_of, roll_out_borders
from simgap.gap.sampling.points import covering_grid, own_point
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.plants.context import Context
from simgap.provenance import sections_digest, sections_of
from simgap.simulators.rollouts import make_simulator
from tests.recipes.scratch import gap_of

TAU, B = 0.1, 0.3


def cart(folder, along, tolerance=1e-12, **changes):
    """A cart of 1 kg, which rubs in the simulator: its gap depends on the speed, not on the place."""
    case = {
        "name": "cart",
        "plant": {
            "states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}, "z": {"unit": "m"}},
            "inputs": {"F": {"unit": "N"}},
            "symbolic": {"dynamics": {"x": "v", "v": "F", "z": "-z"}},
        },
        "domain": {"tau": TAU, "X": {"x": [-1, 2], "v": [-1, 1], "z": [0, 1]}, "U": {"F": {"values": [-1, 1]}}},
        "simulator": {
            "engine": "equations", "integrator": "explicit_euler", "slopes": "sampled",
            "equations": {"dynamics": {"x": "v", "v": f"F - {B}*v", "z": "-z"}},
        },
        "symmetry": {"group": "translation", "along": along, "tolerance": dict.fromkeys("xvz", tolerance),
                     "histories": 20, "headings": 4},
        "grid": {"half_widths": {name: w for name, w in {"x": 0.1, "v": 0.1, "z": 0.06}.items() if name not in along}},
        "gap": {"basis": ["v", "1"]},
    } | changes  # fmt: skip
    path = folder / "cart.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    return path


def deviation(path):
    context = Context.load(path)
    name = own_point(context.case)
    states = {part: border_states(context, name, part).x for part in parts_of(context)}
    rolled, _ = roll_out_borders(context.case, context.folder, states, context.input_set)
    _, _, lower, upper = border_gaps(context, rolled, SHIFTED, border_states(context, name, SHIFTED))
    return context, SymmetryDeviation.of_translation(context, lower, upper)


def test_cells_are_those_of_the_half_widths_and_one_along_the_translation(tmp_path):
    context = Context.load(cart(tmp_path, ["x"]))
    name = own_point(context.case)
    grid = covering_grid(context.case, context.box, name)
    assert name == "cells~1-10-9"  # 1 / 0.12 = 8.3 cells of half-width 0.06
    assert grid.cells == (1, 10, 9)
    assert (grid.h[1:] <= [0.1, 0.06]).all()


def test_what_does_not_depend_on_the_place_deviates_by_rounding(tmp_path):
    context, found = deviation(cart(tmp_path, ["x"]))
    assert found.largest.max() < 1e-14
    found.check(context.states, context.case.symmetry.tolerance)


def test_a_false_symmetry_is_measured_at_its_worst_and_refused(tmp_path):
    context, found = deviation(cart(tmp_path, ["x", "v"]))
    assert found.largest == pytest.approx([0.0, TAU * B * 1.0, 0.0], abs=1e-12)  # from v = 0 to an end of its axis
    with pytest.raises(BrokenPromise, match=r"x, v the gap in v deviates by 0\.03"):
        found.check(context.states, context.case.symmetry.tolerance)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grid": {"half_widths": {"v": 0.1}}}, "it needs"),
        ({"grid": {"half_widths": {"v": 0.1, "z": 0.1}, "eps": 0.1}}, "one of them"),
        ({"grid": {"half_widths": {"v": 0.1, "z": -1}}}, "z: the number must be above 0"),
        ({"symmetry": {"group": "translation", "tolerance": {}}}, "name them"),
        ({"symmetry": {"group": "translation", "along": ["y"], "tolerance": {}}}, "symmetry.along"),
    ],
)
def test_grids_and_symmetries_that_do_not_fit_are_one_line(tmp_path, changes, said):
    with pytest.raises(UserError, match=said):
        load_case(cart(tmp_path, ["x"], **changes))


def test_the_new_keys_are_in_the_hashes_where_they_are_used(tmp_path, root):
    def digest(path, stage):
        case = load_case(path)
        return sections_digest(case, sections_of(stage, case), path.parent)

    stages = ("grid", "borders", "scp", "lipschitz", "gap")
    before = [digest(cart(tmp_path, ["x"]), stage) for stage in stages]
    after = [digest(cart(tmp_path, ["x", "z"], grid={"half_widths": {"v": 0.1}}), stage) for stage in stages]
    assert not set(before) & set(after)
    plain = load_case(root / "configs/cases/pendulum.yaml")
    assert "half_widths" not in plain.model_dump()["grid"]
    assert "symmetry" not in sections_of("grid", plain)
    assert "along" not in load_case(root / "configs/cases/turtlebot.yaml").model_dump()["symmetry"]


def test_the_bound_of_the_cart_pole_holds_wherever_the_cart_is_and_however_fast(tmp_path, root):
    case = yaml.safe_load((root / "configs/cases/cart_pole.yaml").read_text())
    case["plant"]["urdf"] = str(root / "configs/models/cart_pole.urdf")
    case["domain"]["U"]["F"] = {"values": [-5, 5]}
    case["symmetry"] |= {"histories": 5, "headings": 3}
    case["grid"] = {"half_widths": {"a": 0.0125, "w": 0.06}, "shards": 1}
    case["gap"] |= {"fresh_samples": 500, "lipschitz": {"extreme_value": False}}
    path = tmp_path / "cart_pole.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    bound, context = gap_of(path), Context.load(path)
    assert bound.domain.free == (0, 1)
    rng = np.random.default_rng(5)
    x, u = context.box.sample(rng, 300), rng.choice([-5.0, 5.0], (300, 1))
    simulator = make_simulator(context.case, context.folder)
    d = simulator.rollouts(x, u) - context.plant.sampled.step(x, u)
    simulator.close()
    lo, hi = bound.bounds(x, u)
    assert (lo <= d).all()
    assert (d <= hi).all()
    assert any("not to depend on x, v" in tier.text for tier in bound.tiers)
    assert ((hi - lo).max(axis=0) < [0.01, 0.2, 0.01, 0.2]).all()  # of gaps of .03 to .5


STOPPED = """<?xml version="1.0"?><robot name="w"><link name="rail"/><link name="cart"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="slide" type="prismatic">
<parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="-1.1" upper="9" effort="9" velocity="9"/>
</joint></robot>"""


@pytest.mark.parametrize(("speed", "stopped"), [(0.5, False), (1.5, True)])
def test_stops_that_a_step_reaches_are_named_where_the_symmetry_fails(tmp_path, speed, stopped):
    """X ends 0.1 m before a stop and a step is 0.1 s long: faster than 1 m/s it is reached."""
    (tmp_path / "w.urdf").write_text(STOPPED)
    states = {"x": {"joint": "slide", "quantity": "position", "unit": "m"},
              "v": {"joint": "slide", "quantity": "velocity", "unit": "m/s"}}  # fmt: skip
    path = cart(
        tmp_path, ["x"], plant={"urdf": "w.urdf", "states": states, "inputs": {"F": {"joint": "slide", "unit": "N"}}},
        domain={"tau": TAU, "X": {"x": [-1, 2], "v": [-speed, speed]}, "U": {"F": {"values": [-1, 1]}}},
        grid={"half_widths": {"v": 0.1}}, simulator={"engine": "pybullet", "inertia": "file", "substeps": 10},
        symmetry={"group": "translation", "along": ["x"], "tolerance": {"x": 1e-9, "v": 1e-9}},
    )  # fmt: skip
    stops = reached_stops(Context.load(path), ["x"])
    found = SymmetryDeviation(np.array([0.2, 0.0]), 10, ("x",))
    with pytest.raises(BrokenPromise) as refused:
        found.check(["x", "v"], {"x": 1e-9, "v": 1e-9}, stops)
    assert ("joint 'slide' (x in [-1, 2], stops at -1.1 and 9)" in str(refused.value)) == stopped
