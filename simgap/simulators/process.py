"""Engines run in processes of their own, so that a crash, a global state or chatter on stdout stays there.

Such a process is Python with a pipe to the run that started it and a page of memory for its note. Both are inherited
and have no name, so that nothing is left of them whatever kills the run, and its group with it. It imports nothing of
the caller's script, which needs no guard, and nothing from the current folder before the caller's own path is there.
"""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, TypeVar

from simgap import plugins, reading
from simgap.errors import SimgapError
from simgap.simulators.supervision import LOOK, NOTE, Note, is_too_large, note_in

T = TypeVar("T")
_BEGIN = (
    "import sys; from multiprocessing.connection import Connection; pipe = Connection(int(sys.argv[1])); "
    "sys.path[:] = pipe.recv(); from simgap.simulators.process import serve; serve(pipe, *map(int, sys.argv[2:]))"
)


class EngineCrash(SimgapError):
    """The engine's process died."""


def serve(pipe: Connection, note_file: int, parent: int) -> None:
    """Run in an engine's process what comes through the pipe, until the run, process `parent`, closes it or ends.

    Plug-in files that the run has run are run here too, before a case that holds their sections is unpickled.
    """
    note = note_in(mmap.mmap(note_file, NOTE))
    threading.Thread(target=_end_with_parent, args=(note, parent), name="watchdog", daemon=True).start()
    plugins.adopt(pipe.recv())
    while True:
        try:
            task, job = pipe.recv()
        except EOFError:
            return
        try:
            answer = True, task(*job)
        except Exception as error:
            error.add_note(traceback.format_exc())  # where it happened is not pickled
            answer = False, error
        pipe.send(answer)


def _end_with_parent(note: Note, parent: int) -> None:
    """Follow the run's death, so that a killed one leaves no engine behind; end a process that grows too large."""
    while os.getppid() == parent:
        if is_too_large():
            note.too_large()
            break
        time.sleep(LOOK)
    os._exit(1)


class _Worker:
    """A process that runs one task after the other; what C code prints (file descriptors 1 and 2) goes to the log."""

    def __init__(self, log: Path | None) -> None:
        self._pipe, theirs = Pipe()
        note_file = os.memfd_create("simgap")
        os.ftruncate(note_file, NOTE)
        self.note = Note(mmap.mmap(note_file, NOTE))
        place, flags = reading.real(log) if log else os.devnull, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
        target, passed = os.open(place, flags, 0o644), (theirs.fileno(), note_file)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _BEGIN, *map(str, (*passed, os.getpid()))],
                pass_fds=passed, stdin=subprocess.DEVNULL, stdout=target, stderr=target,
            )  # fmt: skip
        finally:
            theirs.close()
            os.close(note_file)
            os.close(target)
        self._pipe.send([entry or os.getcwd() for entry in sys.path])
        self._pipe.send(plugins.files())

    def ask(self, task: Callable[..., Any], job: tuple[Any, ...]) -> tuple[bool, Any]:
        """True and the result of the task, or False and its error; EOFError or OSError where the process died."""
        self._pipe.send((task, job))
        answer: tuple[bool, Any] = self._pipe.recv()
        return answer

    def end(self, kill: bool = False) -> None:
        """Let the process end after its task, or at once."""
        if kill:
            self._process.kill()
        else:
            self._pipe.close()
        self._process.wait()


class EnginePool:
    """A thread for each process, which waits for it; a process is started when its thread has something to do."""

    def __init__(self, workers: int, log: Path | None) -> None:
        """Start none yet."""
        self._threads, self._own, self._log = ThreadPoolExecutor(workers), threading.local(), log
        self._workers: list[_Worker] = []
        self._killed = False

    def submit(self, task: Callable[..., T], *job: Any) -> Future[T]:
        """Run `task(*job)` in one of the processes."""
        return self._threads.submit(self._run, task, job)

    def _run(self, task: Callable[..., T], job: tuple[Any, ...]) -> T:
        worker: _Worker | None = getattr(self._own, "worker", None)
        if worker is None:
            self._own.worker = worker = _Worker(self._log)
            self._workers.append(worker)
            if self._killed:
                worker.end(kill=True)
        try:
            went_well, result = worker.ask(task, job)
        except (EOFError, OSError):
            where = f"; its output is in {self._log}" if self._log else ""
            raise EngineCrash(f"an engine process ended: {worker.note.message() or 'it died'}{where}") from None
        if not went_well:
            raise result
        found: T = result
        return found

    def end(self, kill: bool = False) -> None:
        """Wait for what runs, or, where nobody does so any more, kill it."""
        self._killed = kill
        self._threads.shutdown(wait=not kill, cancel_futures=kill)
        for worker in list(self._workers):
            worker.end(kill)


@contextmanager
def engine_pool(workers: int = 1, log: Path | None = None) -> Iterator[EnginePool]:
    """A pool of fresh processes whose engine chatter goes to `log`.

    Results raise what their tasks raise, and EngineCrash if a process died, with what it computed, where it is known,
    and where its last words are. An error, Ctrl-C or an exit of the caller kills them.
    """
    pool = EnginePool(workers, log)
    try:
        yield pool
    except BaseException:
        pool.end(kill=True)
        raise
    pool.end()


def run_in_processes(
    task: Callable[..., T], jobs: Sequence[tuple[Any, ...]], workers: int = 1, log: Path | None = None
) -> list[T]:
    """`[task(*job) for job in jobs]`, each in a separate process.

    Raises:
        EngineCrash: as `engine_pool`.
    """
    with engine_pool(workers, log) as pool:
        return [future.result() for future in [pool.submit(task, *job) for job in jobs]]
