"""A stage ends with the run that started it: a run that is killed leaves no stage behind."""

from __future__ import annotations

import os
import select
import threading

from simgap.io.atomic import host

RUN = "SIMGAP_RUN"
"""Environment variable by which a run tells its stages who it is: this machine's digits, a colon, the process."""


def follow_the_run() -> None:
    """End this process when the run that it is part of has ended; does nothing without one."""
    machine, _, process = os.environ.get(RUN, "").partition(":")
    if machine != host() or not process.isdecimal() or not hasattr(os, "pidfd_open"):
        return  # started by a person, or on another machine by a batch system
    try:
        run = os.pidfd_open(int(process))
    except ProcessLookupError:
        os._exit(1)
    except OSError:
        return
    threading.Thread(target=_end_with, args=(run,), name="follow the run", daemon=True).start()


def _end_with(run: int) -> None:
    select.select([run], [], [])
    os._exit(1)
