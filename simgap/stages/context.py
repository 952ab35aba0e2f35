"""What every stage starts from: a checked case, its folder, its nominal model, a log."""

from __future__ import annotations

import logging

from simgap.plants.context import Context

__all__ = ["Context", "log"]

log = logging.getLogger("simgap")
