"""Arrays in files: what several processes read, mapped, and what does not fit into memory beside everything else.

What is mapped is in memory once. What is spilled lies in a temporary file without a name, which is gone with the
process, however that ends; it is read and written by calls, so that it never counts as memory of the process.
"""

from __future__ import annotations

import pickle
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import IO, Generic, TypeVar, cast

import numpy as np

from simgap.arrays import Floats
from simgap.gap.sampling.values import Kept, Room, Rows, in_memory
from simgap.io.atomic import not_linked

T = TypeVar("T")
ALIGNED = 64  # bytes: where an array may begin


@dataclass(frozen=True)
class Mapped(Generic[T]):
    """A value without its arrays, and where these are; two are the same if their files are.

    Attributes:
        file: of the arrays. content: all else, pickled. spans: first byte of each array, and the one behind its last.
    """

    file: Path
    content: bytes = field(compare=False)
    spans: tuple[tuple[int, int], ...] = field(compare=False)

    @staticmethod
    def of(value: T, file: Path) -> Mapped[T]:
        """Write the arrays; the file must outlive every process that reads them."""
        arrays: list[pickle.PickleBuffer] = []
        content, spans = pickle.dumps(value, protocol=5, buffer_callback=arrays.append), []
        with file.open("wb") as stream:
            stream.write(bytes(ALIGNED))  # an empty file could not be mapped
            for array in arrays:
                stream.write(bytes(-stream.tell() % ALIGNED))
                spans.append((stream.tell(), stream.tell() + stream.write(array.raw())))
        return Mapped(file, content, tuple(spans))

    @lru_cache(maxsize=1)  # noqa: B019 - what one process is given is mostly the same value
    def read(self) -> T:
        """The value, its arrays read-only: what is never looked at is never read."""
        whole = np.memmap(self.file, mode="r").data
        return cast(T, pickle.loads(self.content, buffers=[whole[first:end] for first, end in self.spans]))


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """A new, empty folder, removed at the end, after an error and Ctrl-C too.

    What a signal that ends the process leaves lies where the next run of the same stage removes it.
    """
    shutil.rmtree(folder, ignore_errors=True)
    not_linked(folder).mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


HELD = 2**22
"""Numbers up to which memory is taken: 32 MiB, less than what the imports of a stage take."""
_BYTES = 8


@dataclass(frozen=True, eq=False)
class Stored:
    """Numbers (N, M) in a temporary file in `folder`; what was not written yet has no meaning."""

    folder: Path
    count: tuple[int, int]
    _file: IO[bytes] = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        file = tempfile.TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115 - as long as these numbers
        file.truncate(self.count[0] * self.count[1] * _BYTES)
        object.__setattr__(self, "_file", file)
        weakref.finalize(self, file.close)

    def read(self, rows: slice | Rows) -> Floats:
        """See `Values`."""
        width = self.count[1]
        if not isinstance(rows, slice):
            return np.concatenate([self.read(slice(k, k + 1)) for k in rows]) if len(rows) else np.empty((0, width))
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
        if shape[0] * shape[1] <= held:
            return in_memory(shape)
        stored = Stored(folder, shape)
        return Kept(shape, stored.read, stored.put)

    return room
