"""Runs of one folder know of each other: the same case is refused with who holds it, other cases go side by side."""

import json
import os
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from simgap.cli import app, workflow
from simgap.errors import UserError
from simgap.io.atomic import host
from simgap.io.runs import RUNS, announce, runs_in

HOLD = """
import sys
from pathlib import Path
from simgap.io.runs import announce
announce(Path(sys.argv[1]), ["rod"], "simgap run")
print("at work", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another process whose run of the case `rod` is at work in the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "at work\n"
    yield process
    process.kill()
    process.communicate()


def test_a_run_is_known_while_it_lives_and_forgotten_when_it_was_killed(tmp_path, other):
    (found,) = runs_in(tmp_path)
    assert (found.cases, found.process, found.alive) == (["rod"], other.pid, True)
    assert str(found.process) in str(found)
    assert found.since in str(found)
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert runs_in(tmp_path) == []
    announce(tmp_path, ["rod"], "x")
    assert [path.name for path in (tmp_path / RUNS).glob("*.json")] == [f"{host()}-{os.getpid()}.json"]


def test_the_same_case_is_refused_and_another_is_not(tmp_path, other, monkeypatch):
    monkeypatch.chdir(tmp_path)
    workflow._refuse_beside({"arm"})
    with pytest.raises(UserError) as refused:
        workflow._refuse_beside({"arm", "rod"})
    for words in (f"process {other.pid}", "since 20", "(alive)", "Wait until", "another folder"):
        assert words in str(refused.value)
    assert str(other.pid) in workflow._locked()


def test_a_run_of_another_machine_is_told_and_refuses_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / RUNS).mkdir(parents=True)
    machine = "0" * 8 if host() != "0" * 8 else "1" * 8
    record = {"cases": ["rod"], "process": 4242, "machine": "far", "since": "2026-01-01 00:00:00", "command": "x"} | {
        "temporary": ""
    }
    (tmp_path / RUNS / f"{machine}-4242.json").write_text(json.dumps(record))
    assert [run.alive for run in runs_in(tmp_path)] == [None]
    assert "4242 on far" in workflow._locked()
    assert "--unlock" in workflow._locked()
    workflow._refuse_beside({"rod"})


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"cases": 3}', "\x00"])
def test_a_strangers_file_is_no_run(tmp_path, text):
    (tmp_path / RUNS).mkdir(parents=True)
    (tmp_path / RUNS / "aaaaaaaa-1.json").write_text(text)
    assert runs_in(tmp_path) == []


def test_a_folder_that_takes_no_file_is_left_to_snakemake(tmp_path):
    (tmp_path / ".snakemake").write_text("a file")
    assert announce(tmp_path, ["rod"], "simgap run") == ([], False)


def test_looking_on_is_allowed_beside_a_run(tmp_path, other, monkeypatch):
    """A dry run writes nothing; it is planned without the page of all cases, which comes when the run has ended."""
    monkeypatch.chdir(tmp_path)
    asked = []
    monkeypatch.setattr(workflow, "snakemake", lambda *arguments: asked.append(arguments))
    (tmp_path / "rod.yaml").write_text("name: rod\nplant: {equations: {}}\n")
    monkeypatch.setattr("simgap.config.load.load_case", lambda path: type("Case", (), {"name": path.stem}))
    refused = CliRunner().invoke(app, ["run", "rod.yaml"])
    assert isinstance(refused.exception, UserError)
    assert asked == []
    assert CliRunner().invoke(app, ["run", "rod.yaml", "--dry-run"]).exit_code == 0
    assert len(asked) == 1


def test_an_interrupted_run_is_called_that(tmp_path, monkeypatch):
    """Jobs that are cut short end without a reason, and the run was said to have failed for it."""

    class Cut:
        waited = 0

        def wait(self):
            self.waited += 1
            if self.waited == 1:
                raise KeyboardInterrupt
            return 1

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(workflow.subprocess, "Popen", lambda *command, **how: Cut())
    with pytest.raises(workflow.WorkflowFailed, match=r"interrupted\. What was finished is kept"):
        workflow.snakemake(tmp_path, ["rod"], 1, [])
