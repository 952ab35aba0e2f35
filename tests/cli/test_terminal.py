"""What is said on a terminal: no word of a file moves its cursor, is taken for markup, or cannot be written."""

import ast
import logging
from pathlib import Path

import pytest
from rich.table import Table

import simgap
from simgap.cli import main
from simgap.cli.terminal import console, say, start_log

WORDS = "a[/x] :cat: \x1b[2J\r\u202e\udc80\x9b"
TOLD = r"a[/x] :cat: \x1b[2J\r\u202e\udc80\x9b"


def test_lines(capsys):
    say(f"{WORDS}\n\tnext")
    say(WORDS, err=True)
    said = capsys.readouterr()
    assert said.out == f"{TOLD}\n\tnext\n"
    assert said.err == f"{TOLD}\n"


def test_tables_and_what_stands_below(capsys):
    table = Table(WORDS, box=None)
    table.add_row(WORDS)
    console().print(table)
    console().print(WORDS)
    assert [line.strip() for line in capsys.readouterr().out.splitlines()] == [TOLD] * 3


def test_logs(tmp_path, capsys):
    logger = logging.getLogger("simgap")
    before = logger.handlers, logger.propagate, logger.level
    try:
        for place in (tmp_path / "a.log", None):
            start_log(place)
            logger.warning("%s", WORDS)
            for handler in logger.handlers:
                handler.close()
    finally:
        logger.handlers, logger.propagate = before[:2]
        logger.setLevel(before[2])
    assert (tmp_path / "a.log").read_text().endswith(f"WARNING {TOLD}\n")
    assert TOLD in " ".join(capsys.readouterr().err.split())


def test_errors_of_the_system_and_of_a_command_line(tmp_path, capsys):
    for words in (["schema", "--out", f"\x1b[2J{'a' * 300}"], ["\x1b[2J\n"]):
        with pytest.raises(SystemExit, match=r"[12]"):
            main(words)
        said = capsys.readouterr().err
        assert r"\x1b[2J" in said
        assert said.count("\n") == 1
        assert said.rstrip("\n").isprintable()


def test_nothing_else_speaks():
    """Every line goes through one module: no other prints, echoes, or makes a console of its own.

    What starts Snakemake imports nothing of simgap.
    """
    folder, found = Path(simgap.__file__).parent, []
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                if called in ("print", "typer.echo", "click.echo", "Console", "sys.stderr.write", "sys.stdout.write"):
                    found.append(f"{path.relative_to(folder)}: {called}")
    assert found == ["cli/start.py: sys.stderr.write", "cli/terminal.py: typer.echo", "stages/effects.py: Console"]
