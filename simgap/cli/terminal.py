"""Options that commands share, and the lines, tables and progress that they print.

Words of somebody's files are printed as text, not as markup.
"""

from __future__ import annotations

import json
import logging
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from simgap.errors import UserError
from simgap.io.atomic import new_log, not_linked
from simgap.notation import printable

if TYPE_CHECKING:
    from rich.console import Console


def say(text: str, err: bool = False) -> None:
    """Lines for stdout, or for stderr."""
    typer.echo(printable(text), err=err)


def say_json(content: Any) -> None:
    """A result for another program, on stdout."""
    from simgap.io.results import plain

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


CasePath = Annotated[Path, typer.Argument(help="Case file (YAML).", show_default=False)]


def _writable(path: Path | None, key: str, folder: bool) -> Path | None:
    """A place for a file or a folder that can be written to, asked before anything long is computed for it.

    Nothing is made: the nearest folder that is there takes a file without a name.

    Raises:
        UserError: a link, a file where a folder is needed or the other way round, or a folder that takes no files.
    """
    if path is None:
        return None
    not_linked(path)
    if path.is_dir() and not folder:
        raise UserError("is a folder, a file is to be written", file=path, key=key, remedy="Give another name.")
    if path.exists() and not path.is_dir() and folder:
        raise UserError("is a file, a folder is needed", file=path, key=key, remedy="Give another place.")
    above = next(p for p in (path if folder else path.parent, *path.absolute().parents) if p.exists() or p.is_symlink())
    try:
        with tempfile.TemporaryFile(dir=above):
            return path
    except OSError as error:
        raise UserError(
            f"cannot be written: {above} {'is not a folder' if not above.is_dir() else 'takes no files'} "
            f"({error.strerror or error})", file=path, key=key, remedy="Choose a location that you can write to.",
        ) from None  # fmt: skip


def new_file(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option that names a file to write."""
    return _writable(path, f"--{option.name}", folder=False)


def new_folder(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option that names a folder to write to."""
    return _writable(path, f"--{option.name}", folder=True)


Out = Annotated[Path, typer.Option(help="File to write.", show_default=False, callback=new_file)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
Log = Annotated[Path | None, typer.Option(help="File for the log of this stage; stderr if not given.")]


class _LogFile(logging.FileHandler):
    """A log on a disk that may be full: what fails for it is told on stderr, and once."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Say nothing of a line that could not be written."""

    def close(self) -> None:
        """Close it, with what could be written of it."""
        with suppress(OSError):
            super().close()


def start_log(path: Path | None) -> None:
    """Send this package's log to a file, or to stderr for a person at the keyboard."""
    if path is None:
        from rich.logging import RichHandler

        handler: logging.Handler = RichHandler(console=console(stderr=True), show_path=False)
        handler.setFormatter(LogLines("%(message)s"))
    else:
        new_log(path)
        handler = _LogFile(path, mode="a")  # engines append to the same file
        handler.setFormatter(LogLines("%(asctime)s %(levelname)s %(message)s"))
    logger = logging.getLogger("simgap")
    logger.handlers, logger.propagate = [handler], False
    logger.setLevel(logging.INFO)


def values_of(text: str, key: str) -> dict[str, float]:
    """'q=0.5,v=0' as numbers by name.

    Raises:
        UserError: a text that is something else.
    """
    try:
        pairs = [part.split("=") for part in text.split(",") if part.strip()]
        return {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        raise UserError(f"'{text}' names no state", key=key, remedy="Write q=0.5,v=0.") from None
