"""Why a run failed: what Snakemake writes around an error is long, and the reason stands in its middle."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from simgap import reading

_FAILED = re.compile(r"^Error in rule ([^:]+):$", re.MULTILINE)
_LOG = re.compile(r"^    log: ([^,\n]+?)(?: \(check log file|,|$)", re.MULTILINE)
_ERROR = re.compile(r"^\S+ \S+ ERROR (.+)$", re.MULTILINE)


def reasons(run_logs: Sequence[Path], folder: Path = Path()) -> list[str]:
    """For each job that failed its own reason, as its log has it last, in a line that names the log; each once.

    What `check` refuses stands last, where it is read: other jobs of the case may have met the same mistake, later.

    Args:
        run_logs: what Snakemake wrote of the run.
        folder: where paths of the run start from.
    """
    text = "".join(_text(path) for path in run_logs)
    starts = [match.start() for match in _FAILED.finditer(text)]
    ends = [*starts[1:], len(text)]
    blocks = sorted((text[a:b] for a, b in zip(starts, ends, strict=True)), key=_of_check) if starts else []
    return list(dict.fromkeys(_reason(block, folder) for block in blocks))


def _of_check(block: str) -> bool:
    failed = _FAILED.search(block)
    return failed is not None and failed.group(1) == "check"


def _reason(block: str, folder: Path) -> str:
    """Reason of one job, from where Snakemake speaks of its end."""
    failed, log = _FAILED.search(block), _LOG.search(block)
    rule = failed.group(1) if failed is not None else ""
    if log is None:
        return f"the rule {rule} failed"
    told = _ERROR.findall(_text(folder / log.group(1)))
    return f"{told[-1]} [{rule}, {log.group(1)}]" if told else f"the rule {rule} ended without a reason: {log.group(1)}"


def _text(path: Path) -> str:
    try:
        return reading.read_text(path, errors="replace")
    except OSError:
        return ""
