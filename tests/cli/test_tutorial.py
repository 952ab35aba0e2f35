"""The tutorial's commands, as printed, and what it says they show; its run is planned here, and made in a slow test."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
TEXT, RECORDINGS = ((ROOT / f"docs/tutorials/{name}.md").read_text() for name in ("robot", "recordings"))
PYTHON = (ROOT / "docs/how-to/python.md").read_text()
FENCES = re.findall(r"```(\w*)\n(.*?)```", TEXT + RECORDINGS, flags=re.S)
COMMANDS = list(dict.fromkeys("".join(code for language, code in FENCES if not language).splitlines()))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Folder and what each printed command said, in order."""
    folder, said = tmp_path_factory.mktemp("tutorial"), {}
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "200"}
    for command in COMMANDS:
        typed = command + " --dry-run" if command.startswith("simgap run") else command
        run = subprocess.run(typed, shell=True, cwd=folder, env=env, capture_output=True, text=True, check=False)
        assert run.returncode == 0, (command, run.stderr)
        said[command] = run.stdout + run.stderr
    return folder, said


def test_all_steps_are_there():
    steps = [command.split()[1] for command in COMMANDS]
    assert steps == ["tutorial", "check", "run", "new", "check", "run", "diagnose"]


def test_what_it_says_is_found(done):
    folder, said = done
    assert "The engine takes the model file as it is: nothing is dropped or changed." in said["simgap check rod.yaml"]
    assert "damps every link by 0.04" in said["simgap check mine.yaml"]  # as PyBullet comes
    found = json.loads((folder / "found/diagnosis.json").read_text())
    assert found["verdict"] == "attributed"
    true = {("parameter_error", "rod.mass"): ("ratio", 1.3), ("viscous_friction", "hinge"): ("b", 0.2)}  # make.py
    assert {(e["name"], e["on"]) for e in found["effects"]} == set(true)
    for effect in found["effects"]:
        symbol, value = true[effect["name"], effect["on"]]
        low, high = effect["parameters"][symbol]["ci95"]
        assert low - 0.002 < value < high + 0.002  # the step of the encoder is not noise
    assert f"attributed: {found['sentence']}" in RECORDINGS
    ahead = {when: 1e3 * found["error"][when]["horizon_rmse"]["q"] for when in ("before", "after", "noise_floor")}
    assert f"from {ahead['before']:.0f} mrad to {ahead['after']:.1f} mrad" in RECORDINGS
    assert f"noise floor is {ahead['noise_floor']:.1f} mrad" in RECORDINGS
    corrected = yaml.safe_load((folder / "found/corrected_case.yaml").read_text())
    assert corrected["name"] == "rod_corrected"


def test_the_run_would_make_what_it_shows(done):
    folder, said = done
    planned = said["simgap run rod.yaml --cores 2"]
    for rule in ("check", "rollouts", "gap", "synthesis", "validation", "audit", "report", "trace", "diagnosis"):
        assert re.search(rf"^{rule}\s+\d+$", planned, flags=re.M), rule
    assert not (folder / "results").exists() or not list((folder / "results").rglob("*.npz"))


@pytest.mark.slow
def test_the_run_makes_what_it_shows(tmp_path):
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for command in ("simgap tutorial", "simgap run rod.yaml --cores 2"):
        run = subprocess.run(command, shell=True, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert run.returncode == 0, (command, run.stderr[-2000:])
    expected = json.loads((ROOT / "benchmarks/results/tutorial.json").read_text())
    for when, folder in (("before", "results/rod"), ("after", "results/rod/corrected")):
        summary = json.loads((tmp_path / folder / "summary.json").read_text())
        loops = {k: summary["closed_loop"][k]["simulator"] for k in ("nominal", "gap")}
        assert {k: [t["runs_that_violated_it"], t["runs"]] for k, t in loops.items()} == expected[when]["failed"]
        assert summary["winning_fraction"] == pytest.approx(expected[when]["winning"], abs=1e-3)
    snippets = [code for page in (TEXT, PYTHON) for code in re.findall(r"```python\n(.*?)```", page, flags=re.S)]
    assert len(snippets) == 2
    for code in snippets:  # as plain scripts
        (tmp_path / "snippet.py").write_text(code)
        run = subprocess.run([sys.executable, "snippet.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert run.returncode == 0, (code, run.stderr[-2000:])


def test_a_recording_that_is_gone_ends_the_plan(tmp_path):
    for name in ("rod.yaml", "rod.urdf", "machine.urdf"):
        shutil.copy(ROOT / "docs/tutorial" / name, tmp_path)
    command = [Path(sys.executable).with_name("simgap"), "run", "rod.yaml", "--dry-run"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode
    assert "simgap: rod.yaml: measured.files.0: there is no file: 'swings.csv'. Correct the path" in run.stderr
