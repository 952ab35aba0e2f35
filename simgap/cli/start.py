"""Starts Snakemake in a process of its own: run as a file, so that nothing of simgap is imported for it.

With `--logger simgap` a line says what begins, what is done and what is left; the rest goes to Snakemake's log. Ctrl-C
while it starts leaves no traceback, as it begins with the signal blocked. An unknown option gets the nearest known one.
"""

from __future__ import annotations

import difflib
import json
import logging
import signal
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any

USAGE = 64  # of sysexits.h: the command line was wrong, and a line has said so
JOBS = {"rollouts": 2, "synthesis": 2}
"""Jobs of a stage that `check` estimates as one; 1 for the others."""


class Progress:
    """Progress of a run, from the events that Snakemake logs and the costs that `check` estimates (CPU s)."""

    def __init__(self) -> None:
        self.left, self.rules, self.costs = Counter[str](), dict[int, str](), dict[str, dict[str, float]]()
        self.done = self.total = 0

    def line(self, record: Any) -> str:
        """Line for the terminal about an event; empty for most."""
        event = getattr(record, "event", None)
        if event == "run_info":
            self.left = Counter(record.stats)
            self.total = self.left.pop("total")
        elif event == "progress":
            self.done, self.total = record.done, record.total
        elif event == "job_finished":
            self.left[self.rules[record.job_id]] -= 1
        elif event == "job_info":
            self.rules[record.jobid] = record.rule_name
            self._read_costs(record.wildcards.get("case", ""))
            return f"{self._stand()}: {record.rule_msg}" if record.rule_msg else ""
        elif event == "error" or (event is None and record.levelno >= logging.WARNING):
            return f"simgap: {record.getMessage()}"
        elif event is None and record.getMessage().startswith("Nothing to be done"):
            return str(record.getMessage())
        return ""

    def _read_costs(self, case: str) -> None:
        found = Path("results") / case / "check/check.json"
        if case not in self.costs and found.is_file():
            rows = {row["stage"]: row for row in json.loads(found.read_text())["costs"]}
            begun = rows["workflow"]["seconds"] / rows["workflow"]["count"]
            own = {name: row["seconds"] / JOBS.get(name, 1) for name, row in rows.items() if not row["at_most"]}
            self.costs[case] = {name: begun + own.get(name, 0.0) for name in rows}

    def _stand(self) -> str:
        """How far the run is; a rule costs the mean over the cases that were checked."""
        known = self.costs.values()
        seconds = sum(count * own.get(rule, 0.0) for rule, count in self.left.items() for own in known)
        left = f", about {seconds / len(known) / 60:.1f} min of CPU time left" if seconds else ""
        return f"[{self.done} of {self.total} steps done{left}]"


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
