"""Measures, bounds and closes the gap between a robot model, its simulator and its recordings.

`from simgap import load_controller` reads a synthesised controller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simgap.io.controller_file import load_controller

__all__ = ["load_controller"]


def __getattr__(name: str) -> Any:
    """What the package offers by itself; read on first use, so that importing it costs nothing."""
    if name == "load_controller":
        from simgap.io.controller_file import load_controller

        return load_controller
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
