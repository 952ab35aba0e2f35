"""What commands share: options, places that can be written to, values by name, where their logs go."""

from __future__ import annotations

import logging
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.terminal import LogLines, console
from simgap.errors import UserError
from simgap.io.atomic import new_log, not_linked

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
