"""A search that ends with its time: it runs in a process of its own, and what it found last is its answer.

A search that has no whole answer on its way makes one in a copy of its process, and goes on as if it had not.
"""

from __future__ import annotations

import ctypes
import os
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pickle import UnpicklingError
from typing import Any, TypeVar

from simgap.errors import UserError

Found = TypeVar("Found")
Tell = Callable[[str], None]
_LEAST_S = 1e-6  # 0 is no deadline
PR_SET_PDEATHSIG = 1
"""Option of Linux's prctl: the signal that a process gets when the one that forked it ends, however that ends."""


def last_within(
    seconds: float, search: Callable[[Tell], Iterator[Found]], tell: Tell, *, stoppable: bool = False
) -> Found | None:
    """The last of what `search(tell)` yields within so many seconds of CPU time, or None.

    Then it is ended, whatever it is at: nothing has to be known of how long a game takes, or to compile one. A search
    that fails after it found something has found that, unless it was a refusal. What one that is `stoppable` finds
    before its end is an answer on the way: Ctrl-C leaves it, a failure does not.

    Raises:
        Exception: what the search raises before it finds anything but refusals; a stoppable one, whenever that is.
        UserError: somebody else, such as the system for want of memory, ends it before that.
    """
    here, there = get_context("fork").Pipe(duplex=False)
    process = get_context("fork").Process(target=_report, args=(seconds, search, there, os.getpid()), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: the search asks nothing of them
        process.start()
    there.close()
    last: Found | None = None
    try:
        for kind, value in _received(here):
            if kind == "raised" and (stoppable or last is None or isinstance(last, UserError)):
                raise value
            if kind == "raised":
                return last
            if kind == "told":
                tell(value)
            else:
                last = value
        process.join()
        if (stoppable or last is None) and process.exitcode not in (0, -signal.SIGPROF):
            remedy = "Check that its memory suffices (the system ends what takes too much), then run it again."
            raise UserError(f"the search was ended from outside (signal {-(process.exitcode or 0)})", remedy=remedy)
        return last
    except KeyboardInterrupt:
        if last is None or not stoppable:
            raise
        return last
    finally:
        process.kill()
        process.join()
        here.close()


def _received(pipe: Connection) -> Iterator[tuple[str, Any]]:
    """What comes through a pipe, until its other end is gone: maybe while it sends."""
    with suppress(EOFError, OSError, UnpicklingError):
        while True:
            yield pipe.recv()


def seconds_left() -> float:
    """CPU seconds after which the system ends this process; 0 if it has no deadline."""
    return signal.getitimer(signal.ITIMER_PROF)[0]


def copied() -> bool:
    """True if this is the copy of a process with a deadline, which has what is left of its time.

    The process itself waits until the copy ends, and has so much less.
    """
    left, parent = seconds_left(), os.getpid()
    copy = os.fork()
    if copy == 0:
        _end_with(parent)
        signal.setitimer(signal.ITIMER_PROF, left)
        return True
    _, _, used = os.wait4(copy, 0)
    signal.setitimer(signal.ITIMER_PROF, max(left - used.ru_utime - used.ru_stime, _LEAST_S))
    return False


def _report(seconds: float, search: Callable[[Tell], Iterator[Found]], pipe: Connection, parent: int) -> None:
    """Send what the search tells and finds, until the system ends the process by a signal that nothing handles."""
    _end_with(parent)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which ends this one
    signal.setitimer(signal.ITIMER_PROF, min(max(seconds, _LEAST_S), 1e9))
    try:
        for found in search(lambda words: pipe.send(("told", words))):
            pipe.send(("found", found))
    except BrokenPipeError:  # nobody waits any longer
        return
    except UserError as error:
        pipe.send(("raised", error))
    except Exception:  # not every exception can be pickled, and where it happened never is
        pipe.send(("raised", RuntimeError(traceback.format_exc())))


def _end_with(parent: int) -> None:
    """End this process as soon as the one that forked it has ended."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # ended before that was said
        os.kill(os.getpid(), signal.SIGKILL)
