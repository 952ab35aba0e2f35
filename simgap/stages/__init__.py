"""The thin layer that reads, calls and writes: one file a stage, named like its rule and its subcommand."""

from __future__ import annotations

import logging

log = logging.getLogger("simgap")
