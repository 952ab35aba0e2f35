"""Engines run in processes of their own, so that a crash, a global state or chatter on stdout stays there."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from simgap import plugins, reading
from simgap.errors import SimgapError
from simgap.simulators.unnamed import SharedBytes, Tokens, Unnamed
from simgap.simulators.watched import LOOK, NOTE, Note, grown_too_large, note_in

T = TypeVar("T")


class EngineCrash(SimgapError):
    """The engine's process died."""


def _start(log: str | None, ran: tuple[tuple[Path, bytes], ...], notes: SharedBytes, free: Tokens) -> None:
    """Send what C code prints (file descriptors 1 and 2) to the log file or nowhere; errors come back as exceptions.

    Plug-in files that the parent ran are run here too, before a case that holds their sections is unpickled.
    """
    target = os.open(log or os.devnull, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o644)
    for stream, descriptor in ((sys.stdout, 1), (sys.stderr, 2)):
        stream.flush()
        os.dup2(target, descriptor)
    os.close(target)
    with free:
        *places, taken = _places(notes)
        number = taken[0]
        taken[0] += 1
    note = note_in(places[number])
    threading.Thread(target=_end_with_parent, args=(note,), name="watchdog", daemon=True).start()
    plugins.adopt(ran)


def _end_with_parent(note: Note) -> None:
    """Follow the parent's death, so that a killed run leaves no engine behind; end a process that grows too large."""
    parent = multiprocessing.parent_process()
    while parent is not None and not multiprocessing.connection.wait([parent.sentinel], timeout=LOOK):
        if grown_too_large():
            note.too_large()
            os._exit(1)
    os._exit(1)


def _places(notes: SharedBytes) -> list[memoryview]:
    """A note for each worker, and a byte that counts those that are taken."""
    return [notes.view[k : k + NOTE] for k in range(0, len(notes.view), NOTE)]


@contextmanager
def engine_pool(workers: int = 1, log: Path | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes whose engine chatter goes to `log`.

    Raises:
        EngineCrash: if a process died, with what it computed, where it is known, and where its last words are.
    """
    notes = SharedBytes(workers * NOTE + 1)
    begin = (str(reading.real(log)) if log else None, plugins.files(), notes, Tokens(1))
    others = set(multiprocessing.active_children())
    # Spawned: a forked engine would share its parent's threads and state.
    with ProcessPoolExecutor(workers, mp_context=Unnamed(), initializer=_start, initargs=begin) as pool:
        try:
            yield pool
        except BrokenProcessPool:
            said = [words for place in _places(notes)[:-1] if (words := Note(place).said())]
            where = f"; its output is in {log}" if log else ""
            raise EngineCrash(f"an engine process ended: {' or '.join(said) or 'it died'}{where}") from None
        except BaseException:  # an error, Ctrl-C, an exit: nobody waits for what the others are at
            pool.shutdown(wait=False, cancel_futures=True)
            # One that was being started is no worker of the pool yet; the end of this program would wait for it.
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            raise


def run_in_processes(
    task: Callable[..., T], jobs: Sequence[tuple[Any, ...]], workers: int = 1, log: Path | None = None
) -> list[T]:
    """`[task(*job) for job in jobs]`, each in a separate process.

    Raises:
        EngineCrash: as `engine_pool`.
    """
    with engine_pool(workers, log) as pool:
        return [future.result() for future in [pool.submit(task, *job) for job in jobs]]
