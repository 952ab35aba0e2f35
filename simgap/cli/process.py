"""Settings of a command's own process: Ctrl-C while it is imported, pandas left out, few searches for garbage."""

from __future__ import annotations

import atexit
import gc
import signal
import sys
import threading
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from typing import Any

_OURS = threading.current_thread() is threading.main_thread()
_BEFORE = signal.getsignal(signal.SIGINT)

if _OURS and _BEFORE is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def imported() -> None:
    """From here on it is told as everywhere."""
    if _OURS:
        signal.signal(signal.SIGINT, _BEFORE)


_ROOMS = ("simgap.io.", "pyarrow.dataset")


class _NotForArrow(MetaPathFinder):
    """Finds nothing; says that there is no pandas where `simgap.io` converts and Rerun asks for datasets."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> None:
        """See `importlib.abc.MetaPathFinder`."""
        if fullname != "pandas":
            return
        frame = sys._getframe(1)
        while frame.f_back is not None and "importlib" in frame.f_code.co_filename:
            frame = frame.f_back
        if str(frame.f_globals.get("__name__", "")).startswith(_ROOMS):  # compiled code of pyarrow has no frame
            raise ModuleNotFoundError("no stage needs pandas", name="pandas")


SELDOM = 20_000
"""Objects made between two searches for cycles among them, 700 by default: libraries make 400,000 that stay."""


def without_searching() -> None:
    """Search seldom for cycles of objects, and not at the end of the process, where it took half a second of CPU."""
    gc.set_threshold(SELDOM, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)


def without_pandas() -> None:
    """Keep pyarrow from importing it in this process."""
    if "pandas" not in sys.modules:
        sys.meta_path.insert(0, _NotForArrow())
