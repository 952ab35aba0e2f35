"""What every stage starts from: a checked case and a log."""

from __future__ import annotations

import logging

from simgap.config.context import Context

__all__ = ["Context", "log"]

log = logging.getLogger("simgap")
