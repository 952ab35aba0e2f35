"""Measures, bounds and closes the gap between a robot model, its simulator and its recordings.

`from simgap import load_controller` reads a synthesised controller, `load_plant` the nominal model of a case.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simgap.io.controller_file import load_controller
    from simgap.plants.plant_model import load_plant

__all__ = ["load_controller", "load_plant"]


def __getattr__(name: str) -> Any:
    """What the package offers by itself; read on first use, so that importing it costs nothing."""
    if name == "load_controller":
        from simgap.io.controller_file import load_controller

        return load_controller
    if name == "load_plant":
        from simgap.plants.plant_model import load_plant

        return load_plant
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
