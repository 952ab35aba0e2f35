"""The shipped case studies, at reduced size: each loads and can be checked, those in equations run to a controller."""

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.io.controller_file import load_controller
from simgap.io.results import read_json
from simgap.plants.context import Context
from simgap.simulators.rollouts import make_simulator
from simgap.stages import check, fresh, synthesis, validation
from tests.stages import road

REDUCED = {
    "dcdc": {"grid.eps": 0.02, "synthesis.cells": [120, 120]},
    "dc_motor": {"grid.eps": 0.9, "synthesis.cells": [100, 100], "domain.U.V": {"min": 0, "max": 12, "step": 2}},
}


@pytest.mark.parametrize("name", ["cart_pole", "two_link", "two_link_friction", "vtol"])
def test_a_case_with_a_translation_can_be_checked(root, name):
    found = check.run(root / f"configs/cases/{name}.yaml")
    along = load_case(root / f"configs/cases/{name}.yaml").symmetry.along
    assert {state for state, count in found.cells["samples"].items() if count == 1} == set(along)
    assert not found.findings


@pytest.mark.parametrize("name", REDUCED)
def test_a_case_in_equations_gets_a_controller_that_keeps_its_promise(vary, tmp_path, name):
    path = vary(name, REDUCED[name] | {"gap.fresh_samples": 500, "gap.lipschitz": {"extreme_value": False}})
    drawn, gap, out = (tmp_path / n for n in ("fresh.parquet", "gap.json", "controller.npz"))
    fresh.run(path, drawn, workers=1)
    road.bound(path, tmp_path, road.roll_out(path, tmp_path), drawn, gap)
    synthesis.run(path, gap, out, tmp_path / "synthesis.json", threads=1)
    assert read_json(tmp_path / "synthesis.json")["winning_fraction"] > 0.1
    assert "No Lipschitz" in read_json(gap)["guarantee"][0]["text"]
    case, controller, rng = load_case(path), load_controller(out), np.random.default_rng(3)
    simulator, solution = make_simulator(case, path.parent), controller.solution
    region = case.synthesis.specification
    for cell in rng.choice(np.flatnonzero(solution.winning), 20):
        x = solution.grid.centres()[cell]
        for _ in range(150):
            x = simulator.rollouts(x[None], controller.input(x)[None])[0]
            assert solution.grid.box.contains(x)
        ends = region.safe if name == "dcdc" else region.target
        assert all(lo <= x[list(case.plant.states).index(s)] <= hi for s, (lo, hi) in ends.items())


def test_the_arm_reaches_its_posture_and_avoids_the_other(root, tmp_path):
    """By the nominal model alone; with the gap and in PyBullet in docs/evidence/two_link.md."""
    path, out = root / "configs/cases/two_link.yaml", tmp_path / "controller.npz"
    synthesis.run(path, None, out, tmp_path / "synthesis.json", threads=1)
    context, controller, rng = Context.load(path), load_controller(out), np.random.default_rng(3)
    solution, section = controller.solution, context.case.synthesis.specification
    assert (solution.value > 3).mean() > 0.3

    def within(x, box):
        return all(lo <= x[context.states.index(s)] <= hi for s, (lo, hi) in box.items())

    for cell in rng.choice(np.flatnonzero(solution.value > 3), 20):
        x, left = solution.grid.centres()[cell], int(solution.value[cell])
        while not within(x, section.target):
            assert left > 0
            assert not within(x, section.obstacles[0])
            x, left = context.plant.sampled.step(x[None], controller.input(x)[None])[0], left - 1


def test_a_robot_of_another_make_gets_through_the_door(vary, root, tmp_path):
    """Fewer inputs and cells than `configs/cases/pioneer.yaml`; in full in docs/evidence/pioneer.md."""
    hidden = {"classes": {"v": 2, "w": 3}, "previous": {"v": 3, "w": 3}, "chains": 20, "chain_length": 100}
    changes = {
        "simulator.urdf": str(root / "configs/models/pioneer.urdf"),
        "domain.U.v.step": 0.2,
        "domain.U.w.step": 0.45,
        "hidden_state": hidden | {"fresh_samples": 200, "search": 100},
        "symmetry.histories": 5,
        "symmetry.headings": 2,
        "synthesis.cells": [120, 80, 40],
        "validation": {"starts": 6, "steps": 200, "seed": 1, "first": [{"x": 0.6, "y": 0.6, "theta": 0.0}]},
    }
    case = vary("pioneer", changes)
    assert not check.run(case).findings
    drawn, gap = tmp_path / "fresh.parquet", tmp_path / "bound.json"
    fresh.run(case, drawn, workers=1)
    road.bound(case, tmp_path, road.roll_out(case, tmp_path), drawn, gap)
    files = tmp_path / "nominal.npz", tmp_path / "gap.npz"
    for out, given in zip(files, (None, gap), strict=True):
        synthesis.run(case, given, out, out.with_suffix(".json"), threads=1)
    assert read_json(files[1].with_suffix(".json"))["winning_fraction"] > 0.3
    validation.run(case, *files, gap, tmp_path / "v.json", tmp_path / "traces.parquet", 1)
    judged = read_json(tmp_path / "v.json")["controllers"]["gap"]["simulator"]
    assert judged["runs_that_kept_the_specification"] == judged["runs"] == 6
    assert judged["steps_outside_gamma"] == 0
    assert judged["least_clearance"] > 0
