"""A value that several processes read: its arrays lie in a file that they map, so that they are in memory once."""

from __future__ import annotations

import pickle
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Generic, TypeVar, cast

import numpy as np

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
