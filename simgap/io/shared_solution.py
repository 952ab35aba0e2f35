"""A solution that several processes read: its large tables lie in files that they map into memory, and only once."""

from __future__ import annotations

import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simgap.io.atomic import not_linked
from simgap.specifications.solution import Solution

TABLES = ("winning", "mask", "free", "value", "target", "acting", "chosen")
FLAGS, BYTES = np.empty(0, np.bool_), np.empty((0, 0), np.uint8)  # in the place of tables that lie in files


@dataclass(frozen=True, eq=False)
class SharedSolution:
    """Where the tables of a solution are.

    Attributes:
        folder: of the files. names: of the tables that the solution has. rest: the solution without them.
    """

    folder: Path
    names: tuple[str, ...]
    rest: Solution

    @staticmethod
    def of(solution: Solution, folder: Path) -> SharedSolution:
        """Write the tables; the folder must outlive every process that reads them."""
        names = tuple(name for name in TABLES if getattr(solution, name) is not None)
        for name in names:
            np.save(folder / f"{name}.npy", getattr(solution, name))
        rest = replace(
            solution, winning=FLAGS, mask=BYTES, free=FLAGS, value=None, target=None, acting=None, chosen=None
        )
        return SharedSolution(folder, names, rest)

    def read(self) -> Solution:
        """The solution, its tables mapped and read-only: what is never looked at is never read."""
        return replace(self.rest, **{n: np.load(self.folder / f"{n}.npy", mmap_mode="r") for n in self.names})


TERMINATED = 128 + signal.SIGTERM


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """A new, empty folder, removed at the end: after an error, Ctrl-C and SIGTERM too.

    Nobody can clean up after SIGKILL; what is then left lies where the next run of the same stage removes it.
    """
    shutil.rmtree(folder, ignore_errors=True)
    not_linked(folder).mkdir(parents=True)
    try:
        with _ended_by(signal.SIGTERM):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _ended_by(number: signal.Signals) -> Iterator[None]:
    """Let a signal end the program as an exception does, so that everything is cleaned up."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may say what signals do
        return
    before = signal.signal(number, lambda *_: sys.exit(TERMINATED))
    try:
        yield
    finally:
        signal.signal(number, before)
