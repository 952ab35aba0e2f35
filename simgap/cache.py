"""Where simgap keeps what can be made again at any time."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path | None:
    """`$XDG_CACHE_HOME/simgap`, else `~/.cache/simgap`; None without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "simgap"
    except RuntimeError:
        return None
