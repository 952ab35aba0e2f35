"""The command line: one subcommand a stage, each named like its rule and its module."""

from __future__ import annotations

import logging
import sys
from typing import Any

import typer

from simgap.cli import control, gap, measured, pages, tools
from simgap.cli.options import app
from simgap.errors import SimgapError

__all__ = ["app", "main"]

# The help lists subcommands as a run meets them, whatever the order of the imports.
_ROOMS = [module.__name__ for module in (gap, control, pages, measured, tools)]
app.registered_commands.sort(key=lambda command: _ROOMS.index(getattr(command.callback, "__module__", "")))
# Typer carries a click of its own; its usage errors are found through one of them.
_USAGE: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def main(arguments: list[str] | None = None) -> None:
    """Entry point: a person's mistake is one line on stderr and status 2, a broken promise status 1."""
    logging.getLogger("simgap").addHandler(logging.NullHandler())  # without a log, errors are told once, below
    try:
        result: Any = app(arguments if arguments is not None else sys.argv[1:], standalone_mode=False)
        status = result if isinstance(result, int) else 0
    except SimgapError as error:
        if any(isinstance(h, logging.FileHandler) for h in logging.getLogger("simgap").handlers):
            logging.getLogger("simgap").error("%s", error)
        sys.stderr.write(f"simgap: {error}\n")
        status = error.exit_status
    except _USAGE as error:
        sys.stderr.write(f"simgap: {error} (simgap --help lists what there is)\n")
        status = 2
    except (typer.Abort, KeyboardInterrupt):
        sys.stderr.write("simgap: interrupted\n")
        status = 130
    finally:
        for handler in logging.getLogger("simgap").handlers[:]:
            logging.getLogger("simgap").removeHandler(handler)
            handler.close()
    sys.exit(status)
