"""The tutorial's commands, as printed; its run is planned here, and made in tests/stages/test_new.py stage by stage."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
TEXT, RECORDINGS = ((ROOT / f"docs/tutorials/{name}.md").read_text() for name in ("robot", "recordings"))
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
    assert [command.split()[1] for command in COMMANDS] == ["tutorial", "new", "check", "diagnose", "run", "next"]


def test_what_it_says_is_found(done):
    folder, said = done
    assert "damps every link by 0.04" in said["simgap check rod.yaml"]
    found = json.loads((folder / "found/diagnosis.json").read_text())
    assert found["verdict"] == "attributed"
    (effect,) = found["effects"]
    assert (effect["name"], effect["on"]) == ("coulomb_friction", "hinge")
    low, high = effect["parameters"]["F_c"]["ci95"]
    assert (
        low - 0.002 < 0.15 < high + 0.002
    )  # what docs/tutorial/make.py was given; the step of its encoder is not noise
    assert "Coulomb friction of 0.15 N m at the hinge" in TEXT
    assert f"attributed: {found['sentence']}" in RECORDINGS
    proposed = said["simgap next rod.yaml found/"]
    assert "cannot tell apart Coulomb friction at the hinge and Stribeck friction at the hinge" in proposed
    assert "3.53 s are enough; 20 s would make it 99.9 %" in proposed
    assert "3.53 s of the proposed input are enough, and 20 s would make it 99.9 %" in RECORDINGS
    corrected = yaml.safe_load((folder / "found/corrected_case.yaml").read_text())
    assert corrected["name"] == "rod_corrected"


def test_the_run_would_make_what_it_shows(done):
    folder, said = done
    planned = said["simgap run rod.yaml --cores 2"]
    for rule in ("check", "rollouts", "gap", "synthesis", "validation", "audit", "report", "trace"):
        assert re.search(rf"^{rule}\s+\d+$", planned, flags=re.M), rule
    assert "results/rod/synthesis/gap/controller.npz" in TEXT
    assert not (folder / "results").exists() or not list((folder / "results").rglob("*.npz"))
