"""Progress of a command whose output goes to a file: now and then a line, none of a short one."""

from __future__ import annotations

from simgap.cli import terminal as module


def test_a_line_now_and_then_where_there_is_no_terminal(monkeypatch, capsys):
    clock = iter([0.0, 1.0, 29.0, 30.0, 30.0, 31.0, 61.0, 61.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with module.progress("starting") as tell:
        for words in ("one", "two", "three", "four", "five"):
            tell(words)
    assert capsys.readouterr().err.splitlines() == ["three", "five"]
