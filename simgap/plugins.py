"""The one registry of plug-ins: engines, bases, effects and specifications, found by name and imported when asked for.

A plug-in is a class. Built-ins stand in `BUILT_IN`; a distribution offers its own as entry points of the group's name
(`[project.entry-points."simgap.engines"]`); `file.py:Name` is the class `Name` of a file beside the case. Nothing is
imported before it is used, so that no room depends on the plug-ins that other rooms offer.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import sys
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from simgap import reading
from simgap.errors import UserError, excerpt

_EFFECTS = {
    "parameter_error": "rigid_body:ParameterError", "gravity_tilt": "rigid_body:GravityTilt",
    "wheel_mismatch": "wheels:WheelMismatch", "lateral_slip": "wheels:LateralSlip",
    "rolling_resistance": "wheels:RollingResistance", "viscous_friction": "friction:ViscousFriction",
    "coulomb_friction": "friction:CoulombFriction", "stribeck_friction": "friction:StribeckFriction",
    "quadratic_drag": "friction:QuadraticDrag", "spring": "forces:Spring", "cubic_spring": "forces:CubicSpring",
    "cogging": "forces:Cogging", "sensor_offset": "sensors:SensorOffset", "input_lag": "inputs:InputLag",
    "input_saturation": "inputs:InputSaturation", "input_dead_zone": "inputs:InputDeadZone",
    "input_bias": "inputs:InputBias", "input_gain": "inputs:InputGain", "input_delay": "inputs:InputDelay",
    "reflected_inertia": "rigid_body:ReflectedInertia", "constant_force": "forces:ConstantForce",
    "directional_friction": "friction:DirectionalFriction", "dahl_friction": "friction:DahlFriction",
    "lugre_friction": "friction:LuGreFriction", "load_friction": "friction:LoadFriction",
    "input_directional_gain": "inputs:InputDirectionalGain", "torque_speed_limit": "inputs:TorqueSpeedLimit",
    "sensor_gain": "sensors:SensorGain", "input_curve": "inputs:InputCurve", "force_curve": "forces:ForceCurve",
    "payload": "rigid_body:Payload", "joint_elasticity": "drive_train:JointElasticity",
    "elasticity_behind_encoder": "drive_train:ElasticityBehindEncoder", "backlash": "drive_train:Backlash",
}  # fmt: skip

BUILT_IN: Mapping[str, Mapping[str, str]] = {
    "engines": {
        "pybullet": "simgap.simulators.pybullet:PyBulletJoints",
        "pybullet_wheeled": "simgap.simulators.pybullet:PyBulletWheeled",
        "mujoco": "simgap.simulators.mujoco:MuJoCoJoints",
        "equations": "simgap.simulators.equations:EquationsEngine",
        "python": "simgap.extras.engines.python_function:PythonEngine",
        "drake": "simgap.extras.engines.drake_joints:DrakeJoints",
        "fmu": "simgap.extras.engines.fmu:FmuEngine",
        "mujoco_wheeled": "simgap.extras.engines.mujoco_wheeled:MuJoCoWheeled",
    },
    "bases": {
        "expressions": "simgap.gap.bases:Expressions",
        "monomials": "simgap.gap.bases:Monomials",
        "blocks": "simgap.gap.bases:Blocks",
    },
    "effects": {name: f"simgap.effects.{place}" for name, place in _EFFECTS.items()},
    "specifications": {
        "invariance": "simgap.specifications.invariance:Invariance",
        "reach_avoid": "simgap.specifications.reaching:ReachAvoid",
        "reach_and_stay": "simgap.specifications.reaching:ReachAndStay",
        "task": "simgap.specifications.task:Task",
    },
}
DOORS: Mapping[str, str] = {
    "engines": "simgap.simulators.rollouts",
    "bases": "simgap.gap.fitting.dimension_fit",
    "effects": "simgap.effects",
    "specifications": "simgap.specifications.base",
}
"""For each group the module through which its plug-ins are run: what imports it depends on those that a case uses."""

_ONE = {"engines": "engine", "bases": "basis", "effects": "effect", "specifications": "specification"}
log = logging.getLogger("simgap.code")


def names(group: str) -> tuple[str, ...]:
    """Names of a group: built-ins in their order, then those of installed distributions."""
    return (*BUILT_IN[group], *(name for name in sorted(_offered(group)) if name not in BUILT_IN[group]))


def find(group: str, name: str, folder: Path | None = None) -> type[Any]:
    """The plug-in of that name; `file.py:Name` is looked for in `folder`, that of the case.

    What is not part of simgap is code that runs with the rights of whoever runs simgap; its first use
    is logged.

    Raises:
        UserError: an unknown name, with the known ones; a file that is missing, broken, outside the folder or without
            the class.
    """
    place = BUILT_IN[group].get(name)
    if place is not None:
        module, _, attribute = place.partition(":")
        return _of(importlib.import_module(module), attribute, name)
    if ".py:" in name:
        return _beside(name, folder)
    if name in _offered(group):
        return _installed(group, name)
    raise UserError(f"no {_ONE[group]} is called '{excerpt(name, 80)}'", remedy=f"Known: {', '.join(names(group))}.")


@lru_cache(maxsize=64)
def announce(what: str) -> None:
    """Log, once, that something is a person's code."""
    log.warning("%s is code and runs with your permissions", what)


def source(plugin: type[Any]) -> Path | None:
    """The file that a plug-in stands in, None where there is none; its bytes belong to what a result was made from."""
    module = sys.modules.get(plugin.__module__)
    file = getattr(module, "__file__", None)
    return Path(file) if file else None


def distribution(group: str, name: str) -> tuple[str, str] | None:
    """Name and version of the distribution that offers a plug-in, None for built-ins and files."""
    dist = None if name in BUILT_IN[group] or ".py:" in name else _offered(group)[name].dist
    return (dist.name, dist.version) if dist is not None else None


@lru_cache(maxsize=8)
def _offered(group: str) -> Mapping[str, metadata.EntryPoint]:
    return {point.name: point for point in metadata.entry_points(group=f"simgap.{group}")}


@lru_cache(maxsize=64)
def _installed(group: str, name: str) -> type[Any]:
    point = _offered(group)[name]
    log.warning("plug-in '%s' (%s) is code of %s and runs with your permissions", name, group, point.value)
    try:
        return _of(importlib.import_module(point.module), point.attr, name)
    except ImportError as error:
        raise UserError(f"the plug-in '{name}' cannot be imported: {error}", remedy="Install what it needs.") from None


def _beside(name: str, folder: Path | None) -> type[Any]:
    file, _, attribute = name.rpartition(":")
    if folder is None:
        raise UserError(f"'{excerpt(name, 80)}' is a file, but there is no case for it to stand beside")
    path = reading.real(folder / file)
    if not path.is_relative_to(reading.real(folder)):
        raise UserError(
            f"the plug-in file '{excerpt(file, 80)}' lies outside the case's folder", remedy="Put it beside it."
        )
    if not reading.is_file(path):
        raise UserError("the plug-in file does not exist", file=path, remedy="Put it beside the case.")
    content = reading.read_bytes(path)
    if (path, content) not in _FILES:
        log.warning("plug-in file %s is code and runs with your permissions", path)
    return _of(_module(path, content), attribute, name)


_FILES: dict[tuple[Path, bytes], ModuleType] = {}


def files() -> tuple[tuple[Path, bytes], ...]:
    """Plug-in files that were run in this process, for `adopt` in another one."""
    return tuple(_FILES)


def adopt(ran: Iterable[tuple[Path, bytes]]) -> None:
    """Run plug-in files as another process ran them, so that what it pickled of their classes can be read here."""
    for path, content in ran:
        _module(path, content)


def _module(path: Path, content: bytes) -> ModuleType:
    """The file as a module.

    What runs is what was read: no bytecode is kept beside the file, and other content is another module.
    """
    if (path, content) in _FILES:
        return _FILES[path, content]
    module = ModuleType(f"simgap_plugin_{hashlib.sha256(str(path).encode() + content).hexdigest()[:16]}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[module.__name__]
        raise UserError(
            f"the plug-in does not run: {type(error).__name__}: {excerpt(str(error), 80)}", file=path
        ) from None
    _FILES[path, content] = module
    return module


def _of(module: ModuleType, attribute: str, name: str) -> type[Any]:
    found = getattr(module, attribute, None)
    if not isinstance(found, type):
        raise UserError(
            f"the plug-in '{excerpt(name, 80)}' has no class '{excerpt(attribute, 80)}'", remedy="Check its spelling."
        )
    return found
