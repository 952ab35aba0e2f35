"""A solution that several processes read: its large tables lie in files that they map into memory, and only once."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from simgap.specifications.solution import Solution

TABLES = ("winning", "mask", "free", "value", "target")
FLAGS, BYTES = np.empty(0, np.bool_), np.empty((0, 0), np.uint8)  # in the place of tables that lie in files


@dataclass(frozen=True, eq=False)
class SharedSolution:
    """Where the tables of a solution are.

    Attributes:
        files: of the tables that the solution has. rest: the solution without them.
    """

    files: dict[str, Path]
    rest: Solution

    def read(self) -> Solution:
        """The solution, its tables mapped and read-only: what is never looked at is never read."""
        return replace(self.rest, **{name: np.load(file, mmap_mode="r") for name, file in self.files.items()})


@contextmanager
def shared_solution(solution: Solution) -> Iterator[SharedSolution]:
    """The solution in temporary files, for as long as the block lasts.

    The files have no name: other processes open them through this one's descriptors, and the system takes them back
    however this process ends.
    """
    with ExitStack() as open_files:
        files = {}
        for name in TABLES:
            if getattr(solution, name) is not None:
                stream = open_files.enter_context(TemporaryFile(prefix="simgap-audit-"))
                np.save(stream, getattr(solution, name))
                stream.flush()
                files[name] = Path(f"/proc/{os.getpid()}/fd/{stream.fileno()}")
        rest = replace(solution, winning=FLAGS, mask=BYTES, free=FLAGS, value=None, target=None)
        del solution  # or its tables stay in this process's memory as well
        yield SharedSolution(files, rest)
