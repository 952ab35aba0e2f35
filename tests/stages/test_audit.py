"""The audit from the case to its counts: what holds survives it, what does not is found, kept and shown again."""

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.cli import main
from simgap.config.load import case_content
from simgap.errors import BrokenPromise, UserError
from simgap.gap.sampling.points import successor_columns, units
from simgap.io.arrays_on_disk import Mapped, scratch_folder
from simgap.io.controller_file import load_controller, save_controller
from simgap.io.results import read_json, read_parquet, table, write_json, write_parquet
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import audit, replay, synthesis
from tests.io.recorded import read_curves
from tests.stages.test_sensing_stage import bound

BUDGET = {"evaluations": 6000, "steps": 1500}
STUCK = "no admissible input"


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
    record = provenance("fresh", context.case, context.folder)
    write_parquet(folder / "fresh.parquet", table(columns, units(context.case), {"case": "pendulum"}, record))
    return folder, context, (x, u, following)


def attack(folder, gap, out, controller=None, case=None):
    files = audit.AuditFiles(gap, controller or folder / "controller.npz", [], folder / "fresh.parquet")
    to = audit.AuditOutputs(out / "audit.json", out / "margins.parquet", out / "witness.json")
    audit.run(case or folder / "pendulum.yaml", files, to, 1)
    return read_json(to.counts)


def shrunk(folder, out, by):
    """The bound with `by` taken off its upper side of x2."""
    content = read_json(folder / "gap.json")
    content["gap"]["x2"]["upper"]["offset"] -= by
    write_json(out / "gap.json", content)
    return out / "gap.json"


def passed_off(folder, out, context):
    """The same results, as if they were of another case."""
    out.mkdir()
    gap, law = read_json(folder / "gap.json"), load_controller(folder / "controller.npz")
    gap["provenance"], made, drawn = (
        provenance(stage, context.case, context.folder) for stage in ("gap", "synthesis", "fresh")
    )
    write_json(out / "gap.json", gap)
    save_controller(replace(law, metadata=made), out / "controller.npz")
    fresh = read_parquet(folder / "fresh.parquet")
    said = {b"provenance": json.dumps(drawn, sort_keys=True).encode()}
    write_parquet(out / "fresh.parquet", fresh.replace_schema_metadata(said))
    return out


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
    assert (factor >= 1.0).sum() == counts["margins"]["cells"] == winning
    assert factor[factor >= 1.0].min() == pytest.approx(counts["margins"]["factor"]["least"])
    assert sum(counts["margins"]["lose_by"].values()) == factor.size - winning


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
    at = "runs/gap-aware/simulator/run-0/gap/x2"
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
    assert len(read_curves(recorded)["runs/gap-aware/simulator/run-0/gap/x2/actual"][1]) == steps
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


def test_workers_map_the_tables_of_a_solution_and_load_nothing(made, tmp_path):
    folder, _, _ = made
    solution = load_controller(folder / "controller.npz").solution
    shared = Mapped.of(solution, tmp_path / "tables")
    assert len(pickle.dumps(shared)) < 4000 < solution.mask.nbytes
    again = pickle.loads(pickle.dumps(shared)).read()
    assert not again.mask.flags.writeable
    assert not again.mask.flags.owndata
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


def test_measurements_without_an_input_are_kept_at_the_start_and_on_the_way(made, tmp_path):
    """A controller for exact measurements where they have an error: beside winning cells are some without an input."""
    folder, *_ = made
    error = {"x1": 0.0012, "x2": 0.006}
    content = yaml.safe_load((folder / "pendulum.yaml").read_text()) | {"sensing": {"error": error}}
    case = tmp_path / "pendulum.yaml"
    case.write_text(yaml.safe_dump(content))
    (tmp_path / "witness-7.json").write_text("of an earlier run")
    mistaken = passed_off(folder, tmp_path / "mistaken", Context.load(case))
    with pytest.raises(BrokenPromise, match=r"witness\.json` shows it, and \d of other kinds beside it"):
        attack(mistaken, mistaken / "gap.json", tmp_path, case=case)
    paths = sorted(tmp_path.glob("witness*.json"))
    kept = [read_json(path) for path in paths]
    assert len(kept) == len({(w["kind"], w["plant"], w["end"], len(w["inputs"]) == 0) for w in kept}) > 2
    stuck = [(p, w) for p, w in zip(paths, kept, strict=True) if w["end"] == STUCK and w["plant"] == "simulator"]
    assert {len(w["inputs"]) == 0 for _, w in stuck} == {True, False}
    for path, data in stuck:
        shown = replay.run(path, tmp_path / "seen.rrd")
        x, seen = np.array(data["states"][-1]), np.array(data["measured"][-1])
        assert np.abs(seen - x) == pytest.approx([0.0012, 0.006])  # a corner of the error box
        assert "x1 as measured  x2 as measured" in shown
        assert f"{seen[0]:.6g}" in shown
        assert "the largest difference from what the audit saw is 0." in shown
        at_start = len(data["inputs"]) == 0
        assert (f"ends where it begins: {STUCK}" in shown) == at_start
        curves = read_curves(tmp_path / "seen.rrd")
        assert curves["runs/gap-aware/simulator/run-0/measured/x1"][1].tolist() == [y[0] for y in data["measured"]]


ENDLESS = """
import sys, time
from pathlib import Path
from simgap.stages import audit
audit.Job = lambda *about: 600.0
audit.attack = time.sleep
if __name__ == "__main__":
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    files = audit.AuditFiles(folder / "gap.json", folder / "controller.npz", [], folder / "fresh.parquet")
    to = audit.AuditOutputs(out / "audit.json", out / "margins.parquet", out / "witness.json")
    audit.run(folder / "pendulum.yaml", files, to, 2)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_an_audit_that_is_ended_leaves_no_tables_and_no_engines(made, tmp_path, number):
    """It ends at once, not when its workers are done; what a killed one leaves the next one removes."""
    folder, _, _ = made
    (tmp_path / "endless.py").write_text(ENDLESS)
    tables = tmp_path / ".tables"
    asked = [sys.executable, str(tmp_path / "endless.py"), str(folder), str(tmp_path)]
    listens = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # whatever the tests themselves run behind
    child = subprocess.Popen(asked, start_new_session=True, stderr=subprocess.DEVNULL, preexec_fn=listens)
    try:
        until(lambda: len(workers(child.pid)) == 2 and (tables / "solution").exists())
        engines = workers(child.pid)
        child.send_signal(number)
        child.wait(30)
        until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in engines))
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
    assert child.returncode != 0
    assert tables.exists() == (number != signal.SIGINT)
    if tables.exists():
        with scratch_folder(tables) as empty:
            assert not list(empty.iterdir())
        assert not tables.exists()


def until(done):
    end = time.monotonic() + 90
    while not done():
        assert time.monotonic() < end
        time.sleep(0.1)


def workers(parent):
    """Engine processes of a process, by their number."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            status, command = (path / "stat").read_text(), (path / "cmdline").read_bytes()
        except OSError:
            continue
        if int(status.rpartition(")")[2].split()[1]) == parent and b"serve(pipe" in command:
            found.append(int(path.name))
    return found
