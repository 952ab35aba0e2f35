"""The audit from the case to its counts: what holds survives it, what does not is found, kept and shown again."""

import pickle
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))
from test_sensing_stage import bound

from simgap.cli import main
from simgap.config.load import case_content
from simgap.errors import BrokenPromise, UserError
from simgap.gap.steps.tables import successor_columns, units
from simgap.io.controller_file import load_controller, save_controller
from simgap.io.documents import read_json, write_json
from simgap.io.parquet import read_parquet
from simgap.io.recording_check import read_curves
from simgap.io.samples import write_columns
from simgap.io.shared_solution import shared_solution
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import audit, replay, synthesis
from simgap.stages.context import Context

BUDGET = {"evaluations": 6000, "steps": 1500}


@pytest.fixture(scope="module")
def made(root, tmp_path_factory):
    """The shipped pendulum on few cells: case, bound, controller, and random samples of the simulator."""
    folder = tmp_path_factory.mktemp("audit")
    content = case_content(root / "configs/cases/pendulum.yaml")
    content["plant"]["urdf"] = str(root / "configs/models/pendulum.urdf")
    content["synthesis"]["cells"] = [200, 100]
    content["domain"]["U"]["u"]["step"] = 0.2
    content["audit"] = BUDGET
    content.pop("measured")
    path = folder / "pendulum.yaml"
    path.write_text(yaml.safe_dump(content))
    bound(path, folder / "gap.json")
    synthesis.run(path, folder / "gap.json", folder / "controller.npz", folder / "synthesis.json", 1)
    context, rng = Context.load(path), np.random.default_rng(6)
    x, u = context.box.sample(rng, 6000), context.input_set[rng.integers(0, len(context.input_set), 6000)]
    ((following, _),) = run_in_processes(roll_out, [(context.case, context.folder, x, u)])
    columns = successor_columns(context.case, x, u, following)
    write_columns(folder / "fresh.parquet", columns, units(context.case), {"case": "pendulum"}, {})
    return folder, context, (x, u, following)


def attack(folder, gap, out, controller=None):
    files = audit.Inputs(gap, controller or folder / "controller.npz", [], folder / "fresh.parquet")
    to = audit.Outputs(out / "audit.json", out / "margins.parquet", out / "witness.json")
    audit.run(folder / "pendulum.yaml", files, to, 1)
    return read_json(to.counts)


def shrunk(folder, out, by):
    """The bound with `by` taken off its upper side of x2."""
    content = read_json(folder / "gap.json")
    content["gap"]["x2"]["upper"]["offset"] -= by
    write_json(out / "gap.json", content)
    return out / "gap.json"


def test_a_bound_that_holds_survives(made, tmp_path):
    folder, _, _ = made
    counts = attack(folder, folder / "gap.json", tmp_path)
    assert counts["violations"] == 0
    assert counts["witnesses"] == []
    assert counts["evaluations"] == BUDGET["evaluations"]
    for loop in counts["closed_loop"].values():
        assert loop["steps"] >= BUDGET["steps"]
        assert set(loop["ends"]) == {"stayed"}
    assert not (tmp_path / "witness.json").exists()
    margins = read_parquet(tmp_path / "margins.parquet")
    factor = margins["factor"].to_numpy()
    winning = read_json(folder / "synthesis.json")["winning_cells"]
    assert np.isfinite(factor).sum() == counts["margins"]["cells"] == winning
    least = counts["margins"]["factor"]["least"]
    assert least >= 1.0
    assert np.nanmin(factor) == pytest.approx(least)


def test_a_fault_that_random_samples_miss_is_found_kept_and_shown_again(made, tmp_path, capsys):
    """The bound is shrunk by a little less than what would let one of 6,000 random samples out."""
    folder, context, (x, u, following) = made
    gap = audit.load_gap(folder / "gap.json", context).function
    room = (gap.bounds(x, u)[1] - (following - context.plant.sampled.step(x, u)))[:, 1].min()
    (tmp_path / "out").mkdir()
    faulty = shrunk(folder, tmp_path, 0.999 * room)
    d = following - context.plant.sampled.step(x, u)
    lo, hi = audit.load_gap(faulty, context).function.bounds(x, u)
    assert ((lo <= d) & (d <= hi)).all()
    with pytest.raises(BrokenPromise, match=r"the adversary broke it: .* lie outside gamma.*witness\.json") as caught:
        attack(folder, faulty, tmp_path / "out")
    assert "\n" not in str(caught.value)
    counts = read_json(tmp_path / "out/audit.json")
    assert counts["gap"]["violations"] > 0
    kept = tmp_path / "out/witness.json"
    assert str(folder) not in kept.read_text()
    main_status(["replay", str(kept), "--out", str(tmp_path / "witness.rrd")])
    shown = capsys.readouterr().out
    assert " *" in shown
    assert "1 step outside gamma; the largest difference from what the audit saw is 0." in shown
    gaps = read_curves(tmp_path / "witness.rrd")
    at = "runs/gap/simulator/run-0/gap/x2"
    assert gaps[f"{at}/actual"][1][0] > gaps[f"{at}/upper"][1][0]


def test_runs_that_break_are_shown_again_in_the_simulator_and_against_the_disturbance(made, tmp_path, capsys):
    """A controller that admits every input wherever it has one leaves what is certified."""
    folder, context, _ = made
    whole = load_controller(folder / "controller.npz")
    all_inputs = np.packbits(np.ones(len(context.input_set), bool), bitorder="little")
    mask = np.where(whole.solution.served[:, None], all_inputs, 0).astype(np.uint8)
    save_controller(replace(whole, solution=replace(whole.solution, mask=mask)), tmp_path / "careless.npz")
    with pytest.raises(BrokenPromise, match="the first: a run under the rule"):
        attack(folder, folder / "gap.json", tmp_path, tmp_path / "careless.npz")
    counts, data = read_json(tmp_path / "audit.json"), read_json(tmp_path / "witness.json")
    assert counts["gap"]["violations"] == 0
    assert min(loop["violations"] for loop in counts["closed_loop"].values()) > 0
    assert (data["kind"], data["plant"]) == ("closed-loop run", "simulator")
    steps = len(data["inputs"])
    recorded = tmp_path / "witness.rrd"
    main_status(["replay", str(tmp_path / "witness.json"), "--out", str(recorded)])
    shown = capsys.readouterr().out
    assert data["what"] in shown
    assert "Simulated again: 0 steps outside gamma; the largest difference from what the audit saw is 0." in shown
    assert len(read_curves(recorded)["runs/gap/simulator/run-0/gap/x2/actual"][1]) == steps
    data["states"][-1][1] += 1.0  # nobody simulates the adversary's own states again: they are shown, and so is this
    write_json(tmp_path / "witness.json", data | {"plant": "disturbance"})
    main_status(["replay", str(tmp_path / "witness.json")])
    shown = capsys.readouterr().out
    assert "The states are those that the adversary chose within f + gamma." in shown
    assert shown.count(" *") == 1


def main_status(arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code in (0, None)


def test_a_witness_is_read_with_care(made, tmp_path):
    write_json(tmp_path / "no.json", {"kind": "nothing"})
    with pytest.raises(UserError, match="not a witness"):
        replay.run(tmp_path / "no.json")


def test_workers_map_the_tables_of_a_solution_and_load_nothing(made, tmp_path, monkeypatch):
    folder, _, _ = made
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    solution = load_controller(folder / "controller.npz").solution
    with shared_solution(solution) as shared:
        assert len(pickle.dumps(shared)) < 4000 < solution.mask.nbytes
        again = pickle.loads(pickle.dumps(shared)).read()
    assert not list(tmp_path.iterdir())  # files without a name: a process that is killed leaves none
    assert isinstance(again.mask, np.memmap)
    assert not again.mask.flags.writeable
    for name in ("winning", "mask", "free"):
        assert np.array_equal(getattr(again, name), getattr(solution, name))
    assert again.value is again.target is None
    assert (again.grid.cells, again.memory, again.first) == (solution.grid.cells, solution.memory, solution.first)
    assert again.served is again.served


def test_the_same_audit_gives_the_same_bytes(made, tmp_path):
    folder, _, _ = made
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        attack(folder, folder / "gap.json", tmp_path / name)
    for name in ("audit.json", "margins.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
