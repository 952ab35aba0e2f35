"""What a stage spent, as the last line of its log says: all of it, where Snakemake only looks now and then."""

from __future__ import annotations

import os
import re
from pathlib import Path

from simgap import reading

LINE = "spent %.2f s of CPU time, with its processes"
_SPENT = re.compile(r"INFO spent (\d+\.\d+) s of CPU time, with its processes$", re.MULTILINE)


def spent() -> float:
    """CPU seconds of this process since it began, and of those that it began and waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def spent_by(log: Path) -> float | None:
    """CPU seconds that the last line of a log of a stage tells of; None where there is no such log, or no such line."""
    try:
        found = _SPENT.findall(reading.read_text(log, errors="replace"))
    except OSError:
        return None
    return float(found[-1]) if found else None
