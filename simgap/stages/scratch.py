"""A folder for large tables that several processes map, which is gone when its stage is over, however it ends."""

from __future__ import annotations

import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgap.io.atomic import not_linked

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
