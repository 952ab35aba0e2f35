"""The start of a workflow: Ctrl-C leaves no traceback, options keep their values, a misspelt one is named as that."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from simgap.cli import start, workflow
from simgap.cli.workflow import split

INTERRUPT = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
PARSER = "import argparse\ndef get_argument_parser():\n    return argparse.ArgumentParser()\n"


def ended(folder, command, modules):
    """A process that starts with Ctrl-C blocked, as a workflow does, where some modules are what is said here."""
    for name, text in modules.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process = subprocess.Popen(
            [sys.executable, *command], env=os.environ | {"PYTHONPATH": str(folder)}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    said = "".join(process.communicate(timeout=60))
    return process.returncode, said


@pytest.mark.parametrize(
    ("text", "status"),
    [
        (f"{INTERRUPT}def main(words): pass\n", -signal.SIGINT),  # while it is imported
        (f"{PARSER}def main(words):\n    import os, signal\n    os.kill(os.getpid(), signal.SIGINT)\n", 130),
        (f"{PARSER}def main(words):\n    print(*words)\n    raise SystemExit(1)\n", 1),
    ],
)
def test_ctrl_c_at_any_time_leaves_no_traceback(tmp_path, text, status):
    found, said = ended(
        tmp_path, ["-P", start.__file__, "rod"], {"snakemake/cli.py": text, "snakemake/__init__.py": ""}
    )
    assert found == status, said
    assert said == ("rod\n" if status == 1 else "")


def test_ctrl_c_while_the_command_line_is_imported(tmp_path):
    # what runs the tests may ignore Ctrl-C, and its processes with it
    heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    freed = f"{heard}signal.pthread_sigmask(signal.SIG_UNBLOCK, {{signal.SIGINT}})\nimport simgap.cli"
    assert ended(tmp_path, ["-c", freed], {"typer.py": INTERRUPT}) == (-signal.SIGINT, "")
    told = f"{heard}import simgap.cli\nassert signal.getsignal(signal.SIGINT) is signal.default_int_handler"
    (tmp_path / "typer.py").unlink()
    assert ended(tmp_path, ["-c", told], {}) == (0, "")


@pytest.mark.parametrize(
    ("words", "files", "options"),
    [
        ("--until check rod.yaml", ["rod.yaml"], ["--until", "check"]),
        ("rod.yaml --until check gap", ["rod.yaml"], ["--until", "check", "gap"]),
        ("a.yaml b.yaml", ["a.yaml", "b.yaml"], []),
        ("--dry-run a.yaml -n b.yaml", ["a.yaml", "b.yaml"], ["--dry-run", "-n"]),
        ("rod.yaml --coers 2", ["rod.yaml"], ["--coers", "2"]),
        ("rod", ["rod"], []),
    ],
)
def test_words_behind_an_option_are_its_values(words, files, options):
    assert split(words.split()) == ([Path(f) for f in files], options)


def test_an_option_that_nobody_has_is_named_with_the_nearest(capsys):
    with pytest.raises(SystemExit) as left:
        start.start(["--snakefile", "Snakefile", "--coers", "2", "--quiet"])
    assert left.value.code == start.USAGE
    assert capsys.readouterr().err == (
        "simgap: --coers: neither simgap nor Snakemake has such an option. Did you mean --cores?\n"
    )


def test_a_command_line_that_was_told_ends_with_status_2(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "told.py").write_text(f"raise SystemExit({start.USAGE})")
    monkeypatch.setattr(start, "__file__", str(tmp_path / "told.py"))
    with pytest.raises(workflow.typer.Exit) as left:
        workflow.snakemake(tmp_path, ["rod"], 1, ["--coers"])
    assert left.value.exit_code == 2
