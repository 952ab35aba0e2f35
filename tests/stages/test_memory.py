"""Corrected cases with delay and lag, from the file that the diagnosis writes to the closed loop in the twin."""

import json
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.correction.corrected_case import corrected_case
from simgap.effects import AppliedEffect
from simgap.plants.plant_model import PlantModel
from simgap.provenance import READS, sections_digest
from simgap.simulators.commands import acts_at_once
from simgap.stages import fresh, synthesis, validation
from tests.stages import road

DELAY, LAG = "input_delay", "input_lag"


def found(name, size):
    return AppliedEffect(name, "u", {"delay" if name == DELAY else "T": size})


@pytest.fixture
def corrected(vary, tmp_path):
    """The corrected case of a small exactly matched pendulum in MuJoCo, with what was found on hardware."""

    def make(applied, rig="hardware", **changes):
        case = vary("pendulum", {
            "plant.integrator": "semi_implicit_euler", "domain.tau": 0.02,
            "domain.X": {"x1": [-0.2, 0.2], "x2": [-0.5, 0.5]},
            "domain.U.u": {"min": -1.2, "max": 1.2, "step": 0.4},
            "simulator": {"engine": "mujoco", "damping": {"joint": 0.0}},
            "grid": {"eps": 0.05, "shards": 1}, "gap.fresh_samples": 4000, "synthesis.cells": [50, 40],
            "gap.lipschitz": {"extreme_value": False}, "validation": {"starts": 40, "steps": 200, "seed": 1},
            **changes})  # fmt: skip
        target = tmp_path / "corrected_case.yaml"
        target.write_text(corrected_case(case, target, applied, [], rig, "Found."))
        return target

    return make


def run(path, folder):
    """All stages: -> gap.json, winning fraction, the gap-aware controller's tally in the twin."""
    shards = road.roll_out(path, folder)
    fresh.run(path, folder / "fresh.parquet", None, 1)
    road.bound(path, folder, shards, folder / "fresh.parquet", folder / "gap.json")
    synthesis.run(path, folder / "gap.json", folder / "gap.npz", folder / "synthesis.json", 1)
    fraction = json.loads((folder / "synthesis.json").read_text())["winning_fraction"]
    validation.run(path, folder / "gap.npz", folder / "gap.npz", folder / "gap.json", folder / "v.json",
                   folder / "traces.parquet", 1)  # fmt: skip
    tallies = json.loads((folder / "v.json").read_text())["controllers"]
    return json.loads((folder / "gap.json").read_text()), fraction, tallies["gap"]["simulator"]


def test_a_short_delay_is_covered_by_gamma(corrected, tmp_path):
    path = corrected([found(DELAY, 0.004)])
    case = load_case(path)
    assert list(case.plant.states) == ["x1", "x2"]
    assert case.sensing is None
    assert "Gamma covers it" in path.read_text()
    bound, fraction, tally = run(path, tmp_path)
    assert any("earlier commands" in t["text"] for t in bound["guarantee"])
    assert tally["runs_that_violated_it"] == tally["steps_outside_gamma"] == 0
    assert fraction > 0.3
    sup = {d["state"]: d["sup_size"] for d in bound["dimensions"]}
    # a fifth of the step under the other extreme of U: 3 N^-1 m^-1 s^-2 * tau / 5 * 2.4 N m
    assert sup["x2"] == pytest.approx(3.0 * 0.02 / 5 * 2.4, rel=0.1)


def test_a_delay_of_one_sample_is_the_pending_input(corrected, tmp_path):
    path = corrected([found(DELAY, 0.022)])
    case = load_case(path)
    assert (case.sensing.latency, case.sensing.latency_of) == (1, "input_delay")
    bound, fraction, tally = run(path, tmp_path)
    assert tally["runs_that_violated_it"] == tally["steps_outside_gamma"] == 0
    assert fraction > 0.5
    sup = {d["state"]: d["sup_size"] for d in bound["dimensions"]}
    assert sup["x2"] == pytest.approx(3.0 * 0.02 / 10 * 2.4, rel=0.1)


def test_a_lag_is_a_state_while_it_is_small(corrected, tmp_path):
    path = corrected([found(LAG, 0.03)], **{"grid.eps": 0.09, "domain.U.u": {"min": -1.2, "max": 1.2, "step": 0.6},
                                            "synthesis.cells": [60, 60]})  # fmt: skip
    case = load_case(path)
    assert list(case.plant.states) == ["x1", "x2", "u_lagged"]
    assert case.domain.X["u_lagged"] == (-1.2, 1.2)
    model = PlantModel.of(case, path.parent).sampled
    x, u = np.array([[0.1, 0.2, 0.5]]), np.array([[-0.4]])
    # z+ = z + tau (u - z) / T, and the plant feels z
    v = 0.2 + 0.02 * 3.0 * (0.5 - 0.5 * 9.81 * np.sin(0.1))
    assert np.allclose(model.step(x, u)[0], [0.1 + 0.02 * v, v, 0.5 + 0.02 / 0.03 * (-0.4 - 0.5)])
    _, fraction, tally = run(path, tmp_path)
    assert tally["runs_that_violated_it"] == tally["steps_outside_gamma"] == 0
    assert fraction > 0.1


def test_above_the_stated_size_a_lag_is_left_to_gamma(corrected):
    path = corrected([found(LAG, 0.004)], **{"grid.eps": 0.05, "synthesis.cells": [5000, 5000]})
    assert list(load_case(path).plant.states) == ["x1", "x2"]
    assert "Gamma covers it" in path.read_text()


def test_what_the_simulator_itself_shows_changes_the_model_alone(corrected):
    case = load_case(corrected([found(DELAY, 0.02), found(LAG, 0.03)], rig="simulator"))
    assert case.sensing is None
    assert list(case.plant.states) == ["x1", "x2"]
    assert case.simulator.effects == ()
    assert [e.name for e in case.plant.effects] == [DELAY, LAG]


def test_an_offset_of_a_sensor_does_not_move_the_twin(corrected):
    path = corrected([AppliedEffect("sensor_offset", "x1", {"offset": 0.05})])
    assert load_case(path).simulator.effects == ()
    assert "Subtract the offset" in path.read_text()


def test_a_late_command_is_not_constant_between_samples(vary):
    """The margin of walls that a smooth path earns takes a constant input: with a delay a path left X by .0025."""
    late = {"name": "input_delay", "on": "u", "parameters": {"delay": 0.01}}
    plain, delayed = (load_case(vary("pendulum", {"simulator.effects": e})) for e in ([], [late]))
    assert acts_at_once(plain)
    assert not acts_at_once(delayed)
    digests = [sections_digest(case, READS["synthesis"], Path()) for case in (plain, delayed)]
    assert digests[0] != digests[1]
