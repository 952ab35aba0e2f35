"""The shipped case studies, at reduced size: each loads and can be checked, those in equations run to a controller."""

import numpy as np
import pytest
import road

from simgap.config.load import load_case
from simgap.io.controller_file import load_controller
from simgap.io.documents import read_json
from simgap.simulators.build import make_simulator
from simgap.stages import check, fresh, synthesis
from simgap.stages.context import Context

REDUCED = {
    "dcdc": {"grid.eps": 0.02, "synthesis.cells": [120, 120]},
    "dc_motor": {"grid.eps": 0.9, "synthesis.cells": [100, 100], "domain.U.V": {"min": 0, "max": 12, "step": 2}},
}


@pytest.mark.parametrize("name", ["cart_pole", "two_link", "vtol"])
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
    """By the nominal model alone; with the gap and in PyBullet in docs/two_link.md."""
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
