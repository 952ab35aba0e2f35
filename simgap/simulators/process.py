"""Engines run in processes of their own, so that a crash, a global state or chatter on stdout stays there.

What these processes share has no name: the semaphores of `multiprocessing` stand in /dev/shm until a process of its own
removes them, and SIGKILL of a group of processes, as by a batch system, ends that one too. What stands here ends with
the last process that holds it.
"""

from __future__ import annotations

import io
import mmap
import multiprocessing
import multiprocessing.connection
import os
import select
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import popen_spawn_posix, reduction, resource_tracker, spawn, util
from multiprocessing.context import SpawnContext, SpawnProcess, assert_spawning, set_spawning_popen
from pathlib import Path
from typing import Any, TypeVar

from simgap import plugins, reading
from simgap.errors import SimgapError
from simgap.simulators.supervision import LOOK, NOTE, Note, is_too_large, note_in


class Tokens:
    """A semaphore: a pipe with a byte for each time that it may still be taken."""

    def __init__(self, count: int) -> None:
        """It may be taken `count` times at once; a lock has one."""
        self._hold(*os.pipe())
        os.set_blocking(self._reading, False)
        os.write(self._writing, bytes(count))

    def _hold(self, reading: int, writing: int) -> None:
        self._reading, self._writing = reading, writing
        for descriptor in (reading, writing):
            weakref.finalize(self, os.close, descriptor)

    def acquire(self, block: bool = True, timeout: float | None = None) -> bool:
        """Take it, within `timeout` seconds where that is given; -> whether it was."""
        end = None if timeout is None else time.monotonic() + max(0.0, timeout)
        while True:
            try:
                return bool(os.read(self._reading, 1))
            except BlockingIOError:  # others hold it, or were faster
                left = None if end is None else end - time.monotonic()
                if not block or (left is not None and left <= 0):
                    return False
                self._wait(left)

    def _wait(self, longest: float | None) -> bool:
        poll = select.poll()
        poll.register(self._reading, select.POLLIN)
        return bool(poll.poll(None if longest is None else 1000 * longest))

    def release(self) -> None:
        """Give it back."""
        os.write(self._writing, b"\0")

    @property
    def _semlock(self) -> Tokens:
        return self  # through which a queue asks whether it is full

    def _is_zero(self) -> bool:
        return not self._wait(0.0)

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()

    def __getstate__(self) -> Any:
        """For a process that is being started, which inherits the pipe."""
        assert_spawning(self)
        return reduction.DupFd(self._reading), reduction.DupFd(self._writing)

    def __setstate__(self, state: Any) -> None:
        self._hold(*(descriptor.detach() for descriptor in state))


class SharedBytes:
    """Memory, zeros at first, that a process shares with those that it starts.

    Attributes:
        view: its bytes.
    """

    def __init__(self, size: int) -> None:
        """Share `size` bytes."""
        descriptor = os.memfd_create("simgap")
        os.ftruncate(descriptor, size)
        self._hold(descriptor, size)

    def _hold(self, descriptor: int, size: int) -> None:
        self._descriptor, self._size = descriptor, size
        weakref.finalize(self, os.close, descriptor)
        self.view = memoryview(mmap.mmap(descriptor, size))

    def __getstate__(self) -> Any:
        """For a process that is being started, which inherits it."""
        assert_spawning(self)
        return reduction.DupFd(self._descriptor), self._size

    def __setstate__(self, state: Any) -> None:
        self._hold(state[0].detach(), state[1])


class _Started(popen_spawn_posix.Popen):
    """A process that is told what `multiprocessing` tells it, but for the caller's `__main__`, which it never imports.

    So a script needs no guard: it would run once more in each process. Nothing is imported from the current folder
    (`-P`) before the caller's own path is there.
    """

    _fds: list[int]

    def _launch(self, process_obj: Any) -> None:
        tracker: int = resource_tracker.getfd()  # type: ignore[assignment]
        told = spawn.get_preparation_data(process_obj._name)
        told = {key: value for key, value in told.items() if not key.startswith("init_main")}
        content = io.BytesIO()
        set_spawning_popen(self)
        try:
            reduction.dump(told, content)
            reduction.dump(process_obj, content)
        finally:
            set_spawning_popen(None)
        (alive, held), (read, write) = os.pipe(), os.pipe()  # the first is closed by the process when it ends
        try:
            command = spawn.get_command_line(tracker_fd=tracker, pipe_handle=read)
            passed = [*self._fds, tracker, read, held]
            self.pid = util.spawnv_passfds(os.fsencode(command[0]), [command[0], "-P", *command[1:]], passed)
        finally:
            self.sentinel = alive
            self.finalizer = util.Finalize(self, _close, (alive, write))
            _close(read, held)
        with open(write, "wb", closefd=False) as pipe:
            pipe.write(content.getbuffer())


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


class _Worker(SpawnProcess):
    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        return _Started(process_obj)


class Unnamed(SpawnContext):
    """Fresh processes that import nothing of the caller's script, and queues between them whose locks have no name."""

    Process = _Worker

    def Lock(self) -> Any:
        """A lock."""
        return Tokens(1)

    def BoundedSemaphore(self, value: int = 1) -> Any:
        """A semaphore; that it is given back no more often than taken is not checked."""
        return Tokens(value)


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
        if is_too_large():
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
