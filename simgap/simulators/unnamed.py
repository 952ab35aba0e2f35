"""What processes share without a name in the system: locks and memory of which a killed run leaves nothing.

The semaphores of `multiprocessing` stand in /dev/shm until a process of its own removes them, and SIGKILL of a group of
processes, as by a batch system, ends that one too. What stands here ends with the last process that holds it.
"""

from __future__ import annotations

import mmap
import os
import select
import time
import weakref
from multiprocessing import reduction
from multiprocessing.context import SpawnContext, assert_spawning
from typing import Any


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
        """Of `size` bytes."""
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


class Unnamed(SpawnContext):
    """Fresh processes, and queues between them whose locks have no name."""

    def Lock(self) -> Any:
        """A lock."""
        return Tokens(1)

    def BoundedSemaphore(self, value: int = 1) -> Any:
        """A semaphore; that it is given back no more often than taken is not checked."""
        return Tokens(value)
