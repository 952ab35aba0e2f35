"""Byte code kept between processes where the environment forbids it beside the sources, as container images often do.

A run is some thirty processes; compiling what they import would cost each of them two seconds of CPU and more. The
command line imports this module before any other.
"""

from __future__ import annotations

import os
import sys

from simgap.cache import cache_folder


def keep_bytecode() -> None:
    """Write byte code to the cache folder, in this process and its children, if it may not stand beside the sources."""
    folder = cache_folder()
    if sys.dont_write_bytecode and sys.pycache_prefix is None and folder is not None:
        place = str(folder / "bytecode")
        sys.dont_write_bytecode, sys.pycache_prefix = False, place
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = place


keep_bytecode()
