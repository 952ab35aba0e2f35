"""What the command line says: words of somebody's files are text there, no markup and no control sequences."""

from __future__ import annotations

import json
import logging
from typing import TYPE_CHECKING, Any

import typer

from simgap.notation import printable

if TYPE_CHECKING:
    from rich.console import Console


def say(text: str, err: bool = False) -> None:
    """Lines for stdout, or for stderr."""
    typer.echo(printable(text), err=err)


def say_json(content: Any) -> None:
    """A result for another program, on stdout."""
    from simgap.io.documents import plain

    say(json.dumps(plain(content), indent=1))


def console(stderr: bool = False) -> Console:
    """What tables and changing lines are shown with."""
    import rich.console

    class Plain(rich.console.Console):
        def render_str(self, text: str, **options: Any) -> Any:
            return super().render_str(printable(text), **options)

    return Plain(stderr=stderr, markup=False, emoji=False)


class Lines(logging.Formatter):
    """Of a log."""

    def format(self, record: logging.LogRecord) -> str:
        """The record, printable."""
        return printable(super().format(record))
