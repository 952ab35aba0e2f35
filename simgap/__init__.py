"""Measures, bounds and closes the gap between a robot model, its simulator and its recordings.

What the package offers is listed in `__all__` and described in docs/how-to/python.md. It is read on first use, so that
`import simgap` costs milliseconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from simgap.cache import keep_bytecode, keep_machine_code_by_sources

if TYPE_CHECKING:
    __version__: str
    from simgap.api import check, diagnose, load_gap, load_summary, new_case, run
    from simgap.config.load import load_case
    from simgap.errors import BrokenPromise, UserError
    from simgap.extras.model_export import export_model
    from simgap.io.controller_file import export_controller, load_controller
    from simgap.plants.plant_model import load_plant

__all__ = [
    "BrokenPromise",
    "UserError",
    "check",
    "diagnose",
    "export_controller",
    "export_model",
    "load_case",
    "load_controller",
    "load_gap",
    "load_plant",
    "load_summary",
    "new_case",
    "run",
]
_ROOMS = {
    "BrokenPromise": "errors",
    "UserError": "errors",
    "export_controller": "io.controller_file",
    "export_model": "extras.model_export",
    "load_case": "config.load",
    "load_controller": "io.controller_file",
    "load_plant": "plants.plant_model",
}

keep_bytecode()
keep_machine_code_by_sources()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("simgap")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"simgap.{_ROOMS.get(name, 'api')}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
