"""Progress of a command whose output goes to a file: now and then a line, none of a short one. Progress of a run."""

from __future__ import annotations

import json
import subprocess
import sys

from simgap.cli import start
from simgap.cli import terminal as module

SNAKEFILE = """
rule all:
    input: "index"
rule gap:
    output: "results/{case}/gap.json"
    message: "{wildcards.case}: the gap"
    shell: "touch {output}"
rule index:
    input: "results/rod/gap.json"
    output: "index"
    message: "the index"
    shell: "touch {output}"
"""


def test_a_line_now_and_then_where_there_is_no_terminal(monkeypatch, capsys):
    clock = iter([0.0, 1.0, 29.0, 30.0, 30.0, 31.0, 61.0, 61.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("starting") as tell:
        for words in ("one", "two", "three", "four", "five"):
            tell(words)
    assert capsys.readouterr().err.splitlines() == ["one", "five"]


def test_a_run_says_what_begins_what_is_done_and_what_is_left(tmp_path):
    costs = [
        {"stage": "gap", "seconds": 57.0, "count": 9, "at_most": False},
        {"stage": "workflow", "seconds": 9.0, "count": 3, "at_most": False},
    ]
    check = tmp_path / "results/rod/check/check.json"
    check.parent.mkdir(parents=True)
    check.write_text(json.dumps({"costs": costs}))
    (tmp_path / "Snakefile").write_text(SNAKEFILE)
    command = [sys.executable, "-P", start.__file__, "--logger", "simgap", "--cores", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [
        "[0 of 3 steps done, about 1.0 min of CPU time left]: rod: the gap",
        "[1 of 3 steps done]: the index",
    ]
    (log,) = (tmp_path / ".snakemake/log").iterdir()
    assert "3 of 3 steps (100%) done" in log.read_text()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("Nothing to be done")


def test_what_is_left_is_of_all_cases_that_were_checked_and_of_what_surely_comes(tmp_path, monkeypatch):
    """A pendulum behind a robot was said to take the robot's time, and the robot what it takes at the very most."""
    monkeypatch.chdir(tmp_path)
    for case, gap in (("robot", 594.0), ("pendulum", 54.0)):
        check = tmp_path / f"results/{case}/check/check.json"
        check.parent.mkdir(parents=True)
        rows = (("gap", gap, False), ("validation", 6000.0, True), ("workflow", 12.0, False))
        costs = [{"stage": n, "seconds": s, "count": 2, "at_most": most} for n, s, most in rows]
        check.write_text(json.dumps({"costs": costs}))
    progress = start.Progress()
    progress.left.update({"gap": 2, "validation": 2})
    for case in ("robot", "pendulum", "pendulum", "unknown"):
        progress._read_costs(case)
    assert progress._stand() == "[0 of 0 steps done, about 11.2 min of CPU time left]"  # 594 + 54 + 4 * 6 s
