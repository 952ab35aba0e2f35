"""Where simgap keeps what can be made again at any time."""

from __future__ import annotations

import hashlib
import os
import sys
from functools import cache
from pathlib import Path


def cache_folder() -> Path | None:
    """`$XDG_CACHE_HOME/simgap`, else `~/.cache/simgap`; None without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "simgap"
    except RuntimeError:
        return None


@cache
def kernel_sources(root: Path = Path(__file__).parent) -> str:
    """Digest of every source of the package with compiled kernels in it."""
    texts = (path.read_bytes() for path in sorted(root.rglob("*.py")))
    kernels = [hashlib.sha256(text).hexdigest() for text in texts if b"jit" in text]
    return hashlib.sha256("".join(kernels).encode()).hexdigest()[:16]


def keep_machine_code_by_sources() -> None:
    """Let numba keep the machine code of this very package's kernels apart, before any of them is made.

    numba asks whether a function's own file has changed, and not those of what it calls: kept beside the sources, a
    kernel would go on with the old code of another file.
    """
    given, home = os.environ.get("NUMBA_CACHE_DIR"), cache_folder()
    folder = Path(given) if given else home / "machine_code" if home else None
    if folder is None or folder.name == kernel_sources():  # no place, or a parent process saw to it
        return
    place = str(folder / kernel_sources())
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = place
    os.environ["NUMBA_CACHE_DIR"] = place
