"""A search that ends with its time: it runs in a process of its own, and what it found last is its answer."""

from __future__ import annotations

import ctypes
import os
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TypeVar

from simgap.errors import UserError

Found = TypeVar("Found")
Tell = Callable[[str], None]
PR_SET_PDEATHSIG = 1
"""Of Linux's prctl: the signal that a process gets when the one that forked it ends, however that ends."""


def last_within(seconds: float, search: Callable[[Tell], Iterator[Found]], tell: Tell) -> Found | None:
    """The last of what `search(tell)` yields within so many seconds of CPU time, or None.

    Then it is ended, whatever it is at: nothing has to be known of how long a game takes, or to compile one. A search
    that fails after it found something has found that, unless it was a refusal.

    Raises:
        Exception: what the search raises before it finds anything but refusals.
    """
    here, there = get_context("fork").Pipe(duplex=False)
    process = get_context("fork").Process(target=_report, args=(seconds, search, there, os.getpid()), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of other threads: the search asks nothing of them
        process.start()
    there.close()
    last: Found | None = None
    try:
        while True:
            kind, value = here.recv()
            if kind == "raised" and (last is None or isinstance(last, UserError)):
                raise value
            if kind == "raised":
                return last
            if kind == "told":
                tell(value)
            else:
                last = value
    except EOFError:
        process.join()
        if last is None and process.exitcode not in (0, -signal.SIGPROF):
            raise RuntimeError(f"the search for numbers ended with status {process.exitcode}") from None
        return last
    finally:
        process.kill()
        process.join()
        here.close()


def _report(seconds: float, search: Callable[[Tell], Iterator[Found]], pipe: Connection, parent: int) -> None:
    """Send what the search tells and finds, until the system ends the process by a signal that nothing handles."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # ended before that was said
        return
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which ends this one
    signal.setitimer(signal.ITIMER_PROF, min(max(seconds, 1e-6), 1e9))
    try:
        for found in search(lambda words: pipe.send(("told", words))):
            pipe.send(("found", found))
    except BrokenPipeError:  # nobody waits any longer
        return
    except UserError as error:
        pipe.send(("raised", error))
    except Exception:  # not every exception can be pickled, and where it happened never is
        pipe.send(("raised", RuntimeError(traceback.format_exc())))
