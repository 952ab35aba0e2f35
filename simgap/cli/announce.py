"""Says on stderr that a case runs somebody's code, where no log of the stage says it."""

from __future__ import annotations

import logging

from simgap.cli.terminal import say

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
