"""What a killed run leaves goes with the next one, and nobody's who is alive."""

import json
import os
import signal
import subprocess
import sys

import pytest

from simgap.io.atomic import host
from simgap.io.runs import RUNS, announce

HOLD = """
import sys
from pathlib import Path
from simgap.io.runs import announce
print(announce(Path(sys.argv[1]), ["rod"], "simgap run")[1], flush=True)
sys.stdin.read()
"""


def holder(folder):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    return process, process.stdout.readline().strip()


def lock(folder):
    (folder / ".snakemake/locks").mkdir(parents=True, exist_ok=True)
    (folder / ".snakemake/locks/0.output.lock").write_text("results/a\n")


def record(folder, machine):
    """What a run of process 4242 of a machine has left, alive or not."""
    about = {"cases": ["rod"], "process": 4242, "machine": "m", "since": "2026", "command": "x"}
    (folder / RUNS).mkdir(parents=True, exist_ok=True)
    (folder / RUNS / f"{machine}-4242.json").write_text(json.dumps(about))


def locks(folder):
    return [path.name for path in (folder / ".snakemake/locks").glob("*")]


def test_locks_of_a_killed_run_go_and_those_of_one_that_is_alive_stay(tmp_path):
    first, told = holder(tmp_path)
    assert told == "False"
    lock(tmp_path)
    second, told = holder(tmp_path)
    assert (told, locks(tmp_path)) == ("False", ["0.output.lock"])
    for process in (first, second):
        process.send_signal(signal.SIGKILL)
        process.communicate()
    third, told = holder(tmp_path)
    assert (told, locks(tmp_path)) == ("True", [])
    third.communicate("")


@pytest.mark.parametrize("known", [True, False])
def test_locks_that_another_machine_or_nobody_known_may_hold_stay(tmp_path, known):
    lock(tmp_path)
    if known:
        record(tmp_path, "0" * 8 if host() != "0" * 8 else "1" * 8)
    process, told = holder(tmp_path)
    process.communicate("")
    assert (told, locks(tmp_path)) == ("False", ["0.output.lock"])


def test_locks_of_a_killed_run_stay_while_another_is_alive_and_go_with_the_last(tmp_path):
    first, _ = holder(tmp_path)
    record(tmp_path, host())
    lock(tmp_path)
    second, told = holder(tmp_path)
    assert (told, locks(tmp_path)) == ("False", ["0.output.lock"])
    for process in (first, second):
        process.communicate("")
    assert announce(tmp_path, ["rod"], "x") == ([], True)
    assert locks(tmp_path) == []


STAGE = """
import sys, time
from simgap.io.runs import follow_the_run
follow_the_run()
print("begun", flush=True)
time.sleep(300)
"""


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="needs pidfd_open")
def test_a_stage_ends_with_the_run_that_started_it_and_only_with_that():
    run = subprocess.Popen(["sleep", "300"])
    stages = [
        subprocess.Popen([sys.executable, "-c", STAGE], env=os.environ | env, stdout=subprocess.PIPE, text=True)
        for env in ({"SIMGAP_RUN": f"{host()}:{run.pid}"}, {"SIMGAP_RUN": f"00000000x:{run.pid}"}, {"SIMGAP_RUN": "x"})
    ]
    try:
        assert all(stage.stdout.readline() == "begun\n" for stage in stages)
        run.kill()
        run.wait()
        assert stages[0].wait(timeout=30) == 1
        assert stages[1].poll() is stages[2].poll() is None
    finally:
        for stage in stages:
            stage.kill()
            stage.communicate()
