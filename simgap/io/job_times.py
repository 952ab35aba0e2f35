"""Where the time of a run went: the `benchmark:` files that Snakemake leaves for every job, as rows.

Snakemake looks at a job's processes every half second at first and then every 30 s, so that the CPU time of a job that
lasts loses what came after its last look; what the stage says of itself at the end of its log is taken in its place.
"""

from __future__ import annotations

import csv
import os
import re
from dataclasses import dataclass
from pathlib import Path

from simgap import reading
from simgap.errors import UserError, excerpt


@dataclass(frozen=True)
class JobTime:
    """One job: case and job by name, wall time and CPU time in s, largest resident memory in bytes, end in s."""

    case: str
    job: str
    wall: float
    cpu: float
    memory: float
    ended: float


def job_times(results: Path) -> list[JobTime]:
    """Every job below a folder of results, the costliest first.

    Raises:
        UserError: no such file there, or one that Snakemake did not write.
    """
    found = [_one(results, path) for path in sorted(results.rglob("benchmarks/*.tsv"))]
    if not found:
        raise UserError(
            "no job has left its times here", file=results, remedy="Give the folder `results` of a run, or of one case."
        )
    return sorted(found, key=lambda job: -job.cpu)


def _one(results: Path, path: Path) -> JobTime:
    try:
        with reading.opened_text(path, newline="") as stream:
            row = list(csv.DictReader(stream, delimiter="\t"))[-1]
        wall, cpu, memory = (_number(row[key]) for key in ("s", "cpu_time", "max_rss"))
        ended = path.stat().st_mtime
    except (KeyError, IndexError, ValueError, csv.Error) as error:
        raise UserError(
            f"not a benchmark file of Snakemake ({excerpt(error)})", file=path, remedy="Delete it and run again."
        ) from None
    told = cpu_seconds_in_log(path.parents[1] / "logs" / f"{path.stem}.log")
    cpu = cpu if told is None else told
    case = path.parents[1].relative_to(results)
    return JobTime(str(case) if case.parts else reading.real(results).name, path.stem, wall, cpu, memory * 2**20, ended)


def _number(text: str) -> float:
    return 0.0 if text in ("-", "NA") else float(text)  # a job that ended before Snakemake looked


COST_LINE = "spent %.2f s of CPU time, with its processes"
_SPENT = re.compile(r"INFO spent (\d+\.\d+) s of CPU time, with its processes$", re.MULTILINE)


def cpu_seconds() -> float:
    """CPU seconds of this process since it began, and of those that it began and waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def cpu_seconds_in_log(log: Path) -> float | None:
    """CPU seconds that the last line of a log of a stage tells of; None where there is no such log, or no such line."""
    try:
        found = _SPENT.findall(reading.read_text(log, errors="replace"))
    except OSError:
        return None
    return float(found[-1]) if found else None
