"""What a command leaves out: pandas, which pyarrow would import at its first conversion, and most searches for garbage.

Snakemake brings pandas along; no stage hands data of pandas to pyarrow. What a plug-in imports is not touched, and
neither is a program that uses simgap as a library: only the command line calls this.
"""

from __future__ import annotations

import atexit
import gc
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from typing import Any

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
