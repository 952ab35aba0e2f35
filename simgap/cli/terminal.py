"""What the command line says, and how far it is: words of somebody's files are text there, and no markup."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """Console of Rich for tables and changing lines, without markup."""
    import rich.console

    class Plain(rich.console.Console):
        def render_str(self, text: str, **options: Any) -> Any:
            return super().render_str(printable(text), **options)

    return Plain(stderr=stderr, markup=False, emoji=False)


class LogLines(logging.Formatter):
    """Formatter of a log whose lines are printable."""

    def format(self, record: logging.LogRecord) -> str:
        """The record, printable."""
        return printable(super().format(record))


FIRST_S, EVERY_S = 1.0, 30.0
"""Until the first line about progress where the output is no terminal, and between two of them."""


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """Gives what is to be told of progress, in words; it goes to stderr."""
    from rich.text import Text

    terminal = console(stderr=True)
    if terminal.is_terminal:
        with terminal.status(Text(first)) as status:
            yield lambda words: status.update(Text(printable(words)))
        return
    said = time.monotonic() + FIRST_S - EVERY_S

    def tell(words: str) -> None:
        nonlocal said
        if time.monotonic() - said >= EVERY_S:
            said = time.monotonic()
            say(words, err=True)

    yield tell


CODE = "simgap.code"
"""The logger of plug-ins, functions and FMUs: what it tells goes to the log of a stage like all else."""


class _ToStderr(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        above = logging.getLogger("simgap").handlers
        if all(isinstance(handler, logging.NullHandler) for handler in above):
            say(f"Note: {record.getMessage()}", err=True)


def announce_code() -> None:
    """From now on; once is enough."""
    logger = logging.getLogger(CODE)
    logger.setLevel(logging.WARNING)  # also where a command wants to hear of errors alone
    if not any(isinstance(handler, _ToStderr) for handler in logger.handlers):
        logger.addHandler(_ToStderr())
