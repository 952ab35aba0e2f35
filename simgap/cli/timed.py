"""What `simgap times` prints."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from rich.console import Console
from rich.table import Table

from simgap.io.job_times import JobTime
from simgap.lint.costs import duration, size


def show(console: Console, jobs: Sequence[JobTime]) -> None:
    """A table of the jobs, the costliest first, with the share of the CPU time that each and all before it took."""
    total, so_far = sum(job.cpu for job in jobs), 0.0
    table = Table("case", "job", "wall time", "CPU time", "so far", "memory", box=None)
    for job in jobs:
        so_far += job.cpu
        share = f"{so_far / total:.0%}" if total else "-"
        table.add_row(job.case, job.job, duration(job.wall), duration(job.cpu), share, size(job.memory))
    console.print(table)
    last = datetime.fromtimestamp(max(job.ended for job in jobs)).astimezone()
    console.print(f"{len(jobs)} jobs, {duration(total)} of CPU time; the last ended on {last:%Y-%m-%d at %H:%M %Z}")
