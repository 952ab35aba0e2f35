"""Starts Snakemake in a process of its own: run as a file, so that nothing of simgap is imported for it.

With `--logger simgap` a line says what begins and what is done; the rest goes to Snakemake's log. Ctrl-C
while it starts leaves no traceback, as it begins with the signal blocked. An unknown option gets the nearest known one.
"""

from __future__ import annotations

import difflib
import logging
import signal
import sys
from types import ModuleType
from typing import Any

USAGE = 64  # of sysexits.h: the command line was wrong, and a line has said so


class Progress:
    """Progress of a run, from the events that Snakemake logs."""

    def __init__(self) -> None:
        self.done = self.total = 0

    def line(self, record: Any) -> str:
        """Line for the terminal about an event; empty for most."""
        event = getattr(record, "event", None)
        if event == "run_info":
            self.total = record.stats["total"]
        elif event == "progress":
            self.done, self.total = record.done, record.total
        elif event == "job_info" and record.rule_msg:
            return f"[{self.done} of {self.total} steps done]: {record.rule_msg}"
        elif event == "error" or (event is None and record.levelno >= logging.WARNING):
            return f"simgap: {record.getMessage()}"
        elif event is None and record.getMessage().startswith("Nothing to be done"):
            return str(record.getMessage())
        return ""


def register_progress() -> None:
    """Make `--logger simgap` known to Snakemake."""
    from snakemake_interface_logger_plugins.base import LogHandlerBase
    from snakemake_interface_logger_plugins.registry import LoggerPluginRegistry

    class LogHandler(LogHandlerBase):
        writes_to_stream = has_filter = has_formatter = True
        writes_to_file = needs_rulegraph = False

        def __post_init__(self) -> None:
            self.progress = Progress()

        def emit(self, record: logging.LogRecord) -> None:
            if line := self.progress.line(record):
                _say(line)

    plugin = ModuleType("simgap")
    vars(plugin)["LogHandler"] = LogHandler
    LoggerPluginRegistry().register_plugin("simgap", plugin)


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def misspelt(words: list[str]) -> str:
    """Sentence about the first option that neither simgap nor Snakemake has; empty where each is known."""
    from snakemake.cli import get_argument_parser  # type: ignore[import-untyped]

    register_progress()
    parser = get_argument_parser()
    unknown = [word for word in parser.parse_known_args(words)[1] if word.startswith("-")]
    if not unknown:
        return ""
    option = unknown[0].partition("=")[0]
    near = difflib.get_close_matches(option, parser._option_string_actions, 1)
    meant = f"Did you mean {near[0]}?" if near else "`snakemake --help` lists the options."
    named = option.encode("unicode_escape").decode()
    return f"{named[:80]}: neither simgap nor Snakemake has such an option. {meant}"


def start(words: list[str]) -> None:
    """Run Snakemake with these words."""
    from snakemake.cli import main

    if told := misspelt(words):
        _say(f"simgap: {told}")
        sys.exit(USAGE)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main(words)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    try:
        start(sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is left is to end
