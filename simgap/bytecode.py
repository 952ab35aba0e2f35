"""Byte code kept between processes where the environment forbids it beside the sources, as container images often do.

A run is some thirty processes; compiling what they import would cost each of them two seconds of CPU and more, and a
script that imports simgap as much. The package calls this before it imports anything else.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from importlib.machinery import SourceFileLoader
from importlib.util import cache_from_source
from typing import Any

from simgap.cache import cache_folder

_get_code = SourceFileLoader.get_code


def _mended(self: SourceFileLoader, fullname: str) -> Any:
    """Byte code that a full disk or a limit has cut is deleted: Python 3.11 would keep it, and fail on it."""
    try:
        return _get_code(self, fullname)
    except (EOFError, ValueError):
        path = self.get_filename(fullname)
        with suppress(OSError):  # another process was first, or it may not be deleted
            os.unlink(cache_from_source(path))
        return self.source_to_code(self.get_data(path), path)


def keep_bytecode() -> None:
    """Write byte code to the cache folder, in this process and its children, if it may not stand beside the sources."""
    SourceFileLoader.get_code = _mended  # type: ignore[method-assign, assignment]
    folder = cache_folder()
    if sys.dont_write_bytecode and sys.pycache_prefix is None and folder is not None:
        place = str(folder / "bytecode")
        sys.dont_write_bytecode, sys.pycache_prefix = False, place
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = place
