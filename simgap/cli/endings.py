"""What a person is told of a run that ends without a controller: the last lines, and a page with the reason.

A job may fail, nothing may win, or a case may ask for a bound alone: the page is `no_controller.html` in the folder of
the results, whatever the end was.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.documents import read_json
from simgap.io.pages import render

PAGE, TEMPLATE = "no_controller.html", "no_controller.html.j2"
EMPTY = "empty.json"
"""Beside the summary of a synthesis that won nothing: why."""
_BOUNDED = ("synthesis", "validation", "audit", "trace", "report")
"""Rules that begin when the bound is there: what lies in the folder is that of this run."""
_FAILED = re.compile(r"^Error in rule ([^:]+):$", re.MULTILINE)
_LOG = re.compile(r"^    log: ([^,\n]+?)(?: \(check log file|,|$)", re.MULTILINE)
_ERROR = re.compile(r"^\S+ \S+ ERROR (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Failure:
    """A job that failed: its rule, its log if it has one, and its own reason, as its log has it last."""

    rule: str
    log: str | None
    told: str | None

    def __str__(self) -> str:
        """The reason in a line that names the log."""
        if self.log is None:
            return f"the rule {self.rule} failed"
        if self.told is None:
            return f"the rule {self.rule} ended without a reason: {self.log}"
        return f"{self.told} [{self.rule}, {self.log}]"


def failures(run_logs: Sequence[Path], folder: Path = Path()) -> list[Failure]:
    """Jobs that failed, each once.

    What `check` refuses stands last, where it is read: other jobs of the case may have met the same mistake, later.

    Args:
        run_logs: what Snakemake wrote of the run.
        folder: where paths of the run start from.
    """
    text = "".join(_text(path) for path in run_logs)
    starts = [match.start() for match in _FAILED.finditer(text)]
    blocks = [text[a:b] for a, b in zip(starts, [*starts[1:], len(text)], strict=True)] if starts else []
    return sorted(dict.fromkeys(_failure(block, folder) for block in blocks), key=lambda f: f.rule == "check")


def _failure(block: str, folder: Path) -> Failure:
    failed, log = _FAILED.search(block), _LOG.search(block)
    rule = failed.group(1) if failed is not None else ""
    if log is None:
        return Failure(rule, None, None)
    told = _ERROR.findall(_text(folder / log.group(1)))
    return Failure(rule, log.group(1), told[-1] if told else None)


def _text(path: Path) -> str:
    try:
        return reading.read_text(path, errors="replace")
    except OSError:
        return ""


def write_failed(failed: Sequence[Failure], words: Mapping[str, str], folder: Path = Path()) -> list[Path]:
    """A page in each folder of results of which a job failed, after `check` had nothing against the case.

    `words` are what cases themselves say of why they ask for no controller, by folder.
    """
    found: dict[Path, list[Failure]] = {}
    for failure in failed:
        if failure.log is not None and failure.rule != "check" and "logs" in Path(failure.log).parts:
            found.setdefault(Path(failure.log).parent.parent, []).append(failure)
    checked = {Path(f.log).parent.parent for f in failed if f.rule == "check" and f.log is not None}
    own = {results: why for results, why in found.items() if results not in checked}
    for results, why in own.items():
        bounded = all(f.rule in _BOUNDED for f in why)
        said = [words[str(results)]] if words.get(str(results)) else []
        write_page(folder / results, [f.told or str(f) for f in why] + said, bounded)
    return [results / PAGE for results in own]


def write_page(results: Path, reasons: Sequence[str], bounded: bool) -> Path:
    """The page of a case that has no controller: why, the bound if there is one, and why nothing wins.

    Args:
        results: folder of the case's results. reasons: a sentence each. bounded: whether its bound is of this run.
    """
    gaps = sorted(results.glob("gap/*/gap.json"), key=lambda path: path.stat().st_mtime) if bounded else []
    empty = [_read(path) for path in sorted(results.glob(f"synthesis/*/{EMPTY}")) if bounded]
    page, title = results / PAGE, str(results).rpartition("results/")[2]
    bound = _read(gaps[-1]).get("dimensions", []) if gaps else []
    write_text(page, render(TEMPLATE, title=title, reasons=reasons, bound=bound, empty=[e for e in empty if e]))
    return page


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except UserError:  # of another version, or half written: the page does without
        return {}
