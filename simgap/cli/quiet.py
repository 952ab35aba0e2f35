"""Ctrl-C while the command line is imported ends it without a traceback; imported before anything that takes long."""

from __future__ import annotations

import signal
import threading

_OURS = threading.current_thread() is threading.main_thread()
_BEFORE = signal.getsignal(signal.SIGINT)

if _OURS and _BEFORE is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def imported() -> None:
    """From here on it is told as everywhere."""
    if _OURS:
        signal.signal(signal.SIGINT, _BEFORE)
