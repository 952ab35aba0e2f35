"""Progress of a command whose output goes to a file: now and then a line, none of a short one. Progress of a run."""

from __future__ import annotations

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


def test_a_run_says_what_begins_and_what_is_done(tmp_path):
    (tmp_path / "Snakefile").write_text(SNAKEFILE)
    command = [sys.executable, "-P", start.__file__, "--logger", "simgap", "--cores", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [
        "[0 of 3 steps done]: rod: the gap",
        "[1 of 3 steps done]: the index",
    ]
    (log,) = (tmp_path / ".snakemake/log").iterdir()
    assert "3 of 3 steps (100%) done" in log.read_text()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("Nothing to be done")
