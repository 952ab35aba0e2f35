"""Runs of the workflow that are at work in a folder: their cases, process, machine and beginning.

Each run keeps a file `.snakemake/simgap/runs/<machine>-<process>.json` under a lock of the operating system for as long
as its process lives. Who finds the lock free on the same machine knows that the run is gone. The next run that begins
removes the file and, where no run can be alive, the locks of Snakemake's that a killed one has left.
"""

from __future__ import annotations

import csv
import fcntl
import json
import os
import platform
import re
import select
import shutil
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from simgap import reading
from simgap.errors import UserError, excerpt
from simgap.io.atomic import host

LINKED = ("conda", "conda-archive", "shadow", "singularity")
"""Folders of `.snakemake` in which Snakemake itself makes links."""


RUNS = Path(".snakemake/simgap/runs")
_HELD: list[int] = []
"""Open descriptors: they carry the locks until this process ends."""


@dataclass(frozen=True)
class WorkflowRun:
    """A run: its cases, process, machine, beginning (local time) and command.

    `alive` is None where a machine that is not this one may have it: its processes do not show here.
    """

    cases: list[str]
    process: int
    machine: str
    since: str
    command: str
    alive: bool | None = True

    def __str__(self) -> str:
        """The run in words by which a person finds it."""
        lives = {True: "alive", False: "gone", None: "of another machine: look there whether it lives"}[self.alive]
        return (
            f"`{self.command}` of {', '.join(self.cases) or 'no case'}, process {self.process} on {self.machine}, "
            f"since {self.since} ({lives})"
        )


def announce(folder: Path, cases: Sequence[str], command: str) -> tuple[list[WorkflowRun], bool]:
    """Say that this process is a run of these cases in `folder`, and tidy up after runs that were killed.

    Returns:
        The other runs there that are alive, and whether locks of Snakemake's were removed.
    """
    began, tidied = time.strftime("%Y-%m-%d %H:%M:%S"), False
    own = WorkflowRun(list(cases), os.getpid(), platform.node(), began, command)
    with suppress(OSError):  # a folder that takes no file or no lock: Snakemake says what is wrong with it
        (folder / RUNS).mkdir(parents=True, exist_ok=True)
        one_at_a_time = os.open(folder / RUNS / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
            tidied = _tidy(folder)
            path = folder / RUNS / f"{host()}-{own.process}.json"
            _HELD.append(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o666))
            fcntl.flock(_HELD[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.write(_HELD[-1], json.dumps(asdict(own)).encode())
        finally:
            os.close(one_at_a_time)
    return [run for run in runs_in(folder) if run.alive], tidied


def _tidy(folder: Path) -> bool:
    """Remove what runs of this machine left, unless one may be alive that left it: True if there were locks."""
    locks = folder / ".snakemake/locks"
    left = locks.is_dir() and any(locks.iterdir())
    known = {path: run for path, run in _records(folder).items() if run is not None}
    if any(run.alive or (left and run.alive is None) for run in known.values()) or (left and not known):
        return False
    for path in known:
        path.unlink(missing_ok=True)
    if left:
        shutil.rmtree(locks)
    return left


def runs_in(folder: Path) -> list[WorkflowRun]:
    """Runs of other processes that are alive in `folder`, or may be: those of other machines; in order of beginning."""
    own = f"{host()}-{os.getpid()}.json"
    found = [run for path, run in _records(folder).items() if run is not None and path.name != own]
    return sorted((run for run in found if run.alive is not False), key=lambda run: run.since)


def _records(folder: Path) -> dict[Path, WorkflowRun | None]:
    return {path: _read(path) for path in (folder / RUNS).glob("*.json")} if (folder / RUNS).is_dir() else {}


def _read(path: Path) -> WorkflowRun | None:
    """The run of a file; None of a file that is none (a stranger may have written it)."""
    from pydantic import TypeAdapter

    try:
        with reading.opened_text(path) as stream:
            alive = None if not path.name.startswith(f"{host()}-") else False
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                alive = True
            return replace(TypeAdapter(WorkflowRun).validate_json(stream.read(1 << 16)), alive=alive)
    except (OSError, ValueError):
        return None


RUN = "SIMGAP_RUN"
"""Environment variable by which a run tells its stages who it is: this machine's digits, a colon, the process."""


def follow_the_run() -> None:
    """End this process when the run that it is part of has ended; does nothing without one."""
    machine, _, process = os.environ.get(RUN, "").partition(":")
    if machine != host() or not process.isdecimal() or not hasattr(os, "pidfd_open"):
        return  # started by a person, or on another machine by a batch system
    try:
        run = os.pidfd_open(int(process))
    except ProcessLookupError:
        os._exit(1)
    except OSError:
        return
    threading.Thread(target=_end_with, args=(run,), name="follow the run", daemon=True).start()


def _end_with(run: int) -> None:
    select.select([run], [], [])
    os._exit(1)


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
        remedy = "Give the folder `results` of a run, or of one case."
        raise UserError("no job has left its times here", file=results, remedy=remedy)
    return sorted(found, key=lambda job: -job.cpu)


def _one(results: Path, path: Path) -> JobTime:
    try:
        with reading.opened_text(path, newline="") as stream:
            row = list(csv.DictReader(stream, delimiter="\t"))[-1]
        given = (row[key] for key in ("s", "cpu_time", "max_rss"))
        # - and NA: a job that ended before Snakemake looked
        wall, cpu, memory = (0.0 if text in ("-", "NA") else float(text) for text in given)
        ended = path.stat().st_mtime
    except (KeyError, IndexError, ValueError, csv.Error) as error:
        remedy = "Delete it and run again."
        raise UserError(f"not a benchmark file of Snakemake ({excerpt(error)})", file=path, remedy=remedy) from None
    logged = cpu_seconds_in_log(path.parents[1] / "logs" / f"{path.stem}.log")
    cpu = cpu if logged is None else logged
    case = path.parents[1].relative_to(results)
    return JobTime(str(case) if case.parts else reading.real(results).name, path.stem, wall, cpu, memory * 2**20, ended)


COST_LINE = "spent %.2f s of CPU time, with its processes"
_SPENT = re.compile(r"INFO spent (\d+\.\d+) s of CPU time, with its processes$", re.MULTILINE)


def cpu_seconds() -> float:
    """CPU seconds of this process since it began, and of those that it began and waited for."""
    return sum(os.times()[:4])


def cpu_seconds_in_log(log: Path) -> float | None:
    """CPU seconds that the last line of a log of a stage tells of; None where there is no such log, or no such line."""
    try:
        found = _SPENT.findall(reading.read_text(log, errors="replace"))
    except OSError:
        return None
    return float(found[-1]) if found else None
