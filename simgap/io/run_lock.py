"""Which runs of the workflow are alive in a folder, so that what a killed one left behind goes with the next.

A run holds a lock of the operating system on `.snakemake/simgap.lock` for as long as its process lives; the system
takes it back however the process ends. Runs of different cases may share a folder, so they share the lock. A run that
is alone there removes the locks that Snakemake keeps as files and that end with no process: nobody is left who could
hold them.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from contextlib import suppress
from pathlib import Path

from simgap.io.atomic import host

_HELD: list[int] = []
"""Open descriptors: they carry the locks until this process ends."""


def join(folder: Path) -> bool:
    """Count this process among the runs in `folder`; whether Snakemake's locks of a run that is gone were removed.

    They stay where another machine may have set them: its processes do not show here.
    """
    kept = folder / ".snakemake"
    try:
        kept.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(kept / "simgap.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return False  # Snakemake says what is wrong with the folder
    _HELD.append(descriptor)
    removed = False
    try:
        with suppress(BlockingIOError):  # others are alive here
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            removed = _tidy(kept / "locks", descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_SH)
    except OSError:
        return removed  # a file system without locks: Snakemake's own are all there is
    return removed


def _tidy(locks: Path, descriptor: int) -> bool:
    """Remove locks if the last run here was of this machine; then name this machine as that of the last run."""
    left = locks.is_dir() and any(locks.iterdir())
    if left and os.pread(descriptor, 100, 0) != host().encode():
        return False
    if left:
        shutil.rmtree(locks)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, host().encode(), 0)
    return left
