"""Numbers of states and inputs in a temporary file: what does not fit into memory beside everything else.

The file has no name: it is gone with the process, however that ends. It is read and written by calls and not mapped, so
that it never counts as memory of the process.
"""

from __future__ import annotations

import tempfile
import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from simgap.arrays import Floats
from simgap.gap.sampling.values import Held, Kept, Room, Rows

HELD = 2**22
"""Numbers up to which memory is taken: 32 MiB, less than what the imports of a stage take."""
_BYTES = 8


@dataclass(frozen=True, eq=False)
class Stored(Kept):
    """Numbers (N, M) in a temporary file in `folder`; what was not written yet has no meaning."""

    folder: Path
    count: tuple[int, int]
    _file: IO[bytes] = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        file = tempfile.TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115 - as long as these numbers
        object.__setattr__(self, "_file", file)
        weakref.finalize(self, file.close)

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return self.count

    def __getitem__(self, rows: slice | Rows) -> Floats:
        width = self.count[1]
        if not isinstance(rows, slice):
            return np.concatenate([self[k : k + 1] for k in rows]) if len(rows) else np.empty((0, width))
        self._file.seek(rows.start * width * _BYTES)
        return np.fromfile(self._file, np.float64, (rows.stop - rows.start) * width).reshape(-1, width)

    def put(self, first: int, rows: Floats) -> None:
        """See `Kept`."""
        self._file.seek(first * self.count[1] * _BYTES)
        left = memoryview(rows.tobytes())
        while left:  # a call may take a part; a full disk raises, with its reason
            left = left[self._file.write(left) :]


def room_in(folder: Path, held: int = HELD) -> Room:
    """Memory for up to `held` numbers, a temporary file in `folder` for more."""

    def room(shape: tuple[int, int]) -> Kept:
        return Held.room(shape) if shape[0] * shape[1] <= held else Stored(folder, shape)

    return room
