"""Which runs of the workflow are alive in a folder, so that what a killed one left behind goes with the next.

A run holds a lock of the operating system on `.snakemake/simgap.lock` for as long as its process lives; the system
takes it back however the process ends. Runs of different cases may share a folder, so they share the lock. A run that
is alone there removes the locks that Snakemake keeps as files and that end with no process: nobody is left who could
hold them.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import gettempdir

from simgap.io.atomic import host

LINKED = ("conda", "conda-archive", "shadow", "singularity")
"""Folders of `.snakemake` in which Snakemake itself makes links."""
_HELD: list[int] = []
"""Open descriptors: they carry the locks until this process ends."""


def join(folder: Path, temporary: Path | None = None) -> bool:
    """Count this process among the runs in `folder`; whether Snakemake's locks of a run that is gone were removed.

    They stay where another machine may have set them: its processes do not show here. `temporary` is the folder that
    Snakemake removes when it ends well; those of runs that are gone go too.
    """
    kept = folder / ".snakemake"
    try:
        kept.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(kept / "simgap.lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError:
        return False  # Snakemake says what is wrong with the folder
    _HELD.append(descriptor)
    removed = False
    try:
        with suppress(BlockingIOError):  # others are alive here
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            removed = _tidy(kept / "locks", descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        if temporary is not None:
            os.lseek(descriptor, 0, os.SEEK_END)
            os.write(descriptor, f"\n{temporary}".encode())
    except OSError:
        return removed  # a file system without locks: Snakemake's own are all there is
    return removed


def _tidy(locks: Path, descriptor: int) -> bool:
    """Remove what is left if the last run here was of this machine; then name this machine as that of the last run."""
    left = locks.is_dir() and any(locks.iterdir())
    last, *folders = os.pread(descriptor, 1 << 20, 0).decode(errors="replace").split("\n")
    if last != host():
        if left:
            return False
        folders = []
    for folder in folders:
        _remove_temporary(Path(folder))
    if left:
        shutil.rmtree(locks)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, host().encode(), 0)
    return left


def _remove_temporary(folder: Path) -> None:
    """Remove a folder that Snakemake made, and no other: the file that names it may come from a stranger."""
    own = folder.parent == Path(gettempdir()) and re.fullmatch(r"snakemake[a-z0-9_]{8}", folder.name)
    with suppress(OSError):
        if own and not folder.is_symlink() and folder.stat().st_uid == os.getuid():
            shutil.rmtree(folder)
