"""The command line: one subcommand a stage, each named like its rule and its module."""

from __future__ import annotations

from simgap.cli.process import imported

# isort: split
import errno
import logging
import os
import sys
from pathlib import Path
from typing import Any

import typer

from simgap.cli.commands import app
from simgap.cli.process import without_pandas, without_searching
from simgap.cli.terminal import announce_code, say
from simgap.errors import SimgapError, UserError, excerpt
from simgap.io.atomic import not_linked
from simgap.io.runs import COST_LINE, cpu_seconds, follow_the_run
from simgap.notation import one_line

__all__ = ["app", "main"]

# Typer carries a click of its own; its usage errors are found through one of them.
_USAGE: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


imported()


def main(arguments: list[str] | None = None) -> None:
    """Entry point: a person's mistake is one line on stderr and status 2, a broken promise status 1."""
    os.environ["PYTHONSAFEPATH"] = "1"  # processes of engines and stages import nothing that stands in this folder
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in a job of the workflow: more wait for one another
    follow_the_run()
    without_pandas()
    without_searching()
    logging.getLogger("simgap").addHandler(logging.NullHandler())  # without a log, errors are told once, below
    announce_code()
    try:
        _refuse_settings()
        words = sys.argv[1:] if arguments is None else arguments
        result: Any = app(words or ["--help"], standalone_mode=False)
        status = result if isinstance(result, int) else 0
    except SimgapError as error:
        if _logs_to_a_file():
            logging.getLogger("simgap").error("%s", error)
        say(f"simgap: {error}", err=True)
        status = error.exit_status
    except OSError as error:
        say(f"simgap: {one_line(_of_the_system(error))}", err=True)
        status = 1
    except MemoryError:
        say("simgap: out of memory; `simgap check CASE` states what a run needs", err=True)
        status = 1
    except _USAGE as error:
        command = " ".join(["simgap", *(own.info_name for own in [getattr(error, "ctx", None)] if own and own.parent)])
        example = f", such as {command} robot.yaml" * str(error).startswith("Missing parameter: case")
        say(one_line(f"simgap: {error}{example} ({command} --help lists what there is)"), err=True)
        status = 2
    except (typer.Abort, KeyboardInterrupt):
        say("simgap: interrupted", err=True)
        status = 130
    except Exception:  # a fault of simgap's own: whoever reads the log of the stage finds it there
        if _logs_to_a_file():
            logging.getLogger("simgap").exception("an internal error of simgap")
        raise
    finally:
        logger = logging.getLogger("simgap")
        if _logs_to_a_file():
            logger.info(COST_LINE, cpu_seconds())
        for handler in logger.handlers[:]:
            logger.removeHandler(handler)
            handler.close()
        logger.propagate = True  # as they were, for who calls this from Python
        logger.setLevel(logging.NOTSET)
    sys.exit(status)


def _refuse_settings() -> None:
    """Refuse a folder whose files would steer the libraries below: results would depend on where they are made.

    Raises:
        UserError: numba's or Matplotlib's settings, or MuJoCo's log as a link: they are found by their names.
    """
    for name, library in ((".numba_config.yaml", "numba"), ("matplotlibrc", "Matplotlib")):
        if os.path.lexists(name):
            remedy = "Move it, or run in another folder."
            raise UserError(f"{library} would read its settings from it", file=name, remedy=remedy)
    not_linked(Path("MUJOCO_LOG.TXT"))


def _logs_to_a_file() -> bool:
    return any(isinstance(h, logging.FileHandler) for h in logging.getLogger("simgap").handlers)


def _of_the_system(error: OSError) -> str:
    """One line about what the operating system refused: which file, why, what to do."""
    remedies = {
        errno.ENOSPC: "Free some space and run again: nothing is left half-written.",
        errno.EDQUOT: "Free some space and run again: nothing is left half-written.",
        errno.EACCES: "Choose a location that you can write to.",
        errno.EROFS: "Choose a location that you can write to.",
        errno.EEXIST: "A file is in the way of a folder: choose another location.",
        errno.ENOTDIR: "A file is in the way of a folder: choose another location.",
        errno.EISDIR: "A folder is in the way of a file: choose another location.",
    }
    where = f"{excerpt(error.filename)}: " if error.filename else ""
    return f"{where}{error.strerror or excerpt(error)}. {remedies.get(error.errno or 0, '')}".rstrip()
