"""From a case to its simulator: engines are plug-ins in one dictionary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from simgap.config.case import Case
from simgap.effects import effect
from simgap.effects.base import InputEffect
from simgap.errors import UserError
from simgap.simulators.base import Simulator
from simgap.simulators.commands import CommandPath, command_paths
from simgap.simulators.joints import JointPlant
from simgap.simulators.memory import RememberingInputs


def joint_plant(case: Case, folder: Path) -> JointPlant:
    """Where the states and inputs of a URDF case stand.

    Raises:
        UserError: if the case has no model file for the engine, or no domain.
    """
    plant, section, domain = case.plant, case.simulator, case.domain
    urdf = getattr(section, "urdf", None) or plant.urdf
    if urdf is None or domain is None:
        raise UserError("the simulator needs a model file and a domain", key="simulator.urdf", remedy="Give both.")
    names = list(plant.states)
    joints = tuple(s.joint for s in plant.states.values() if s.quantity == "position" and s.joint)
    place = {(s.joint, s.quantity): names.index(n) for n, s in plant.states.items()}
    return JointPlant(
        urdf=folder / urdf,
        joints=joints,
        positions=tuple(place[j, "position"] for j in joints),
        velocities=tuple(place[j, "velocity"] for j in joints),
        inputs=tuple(tuple(k for k, i in enumerate(plant.inputs.values()) if i.joint == j) for j in joints),
        input_names=tuple(plant.inputs),
        tau=domain.tau,
        gravity=plant.gravity,
    )


def _pybullet(case: Case, folder: Path) -> Simulator:
    from simgap.simulators.pybullet_joints import PyBulletJoints

    return _with_memory(case, folder, PyBulletJoints)


def _mujoco(case: Case, folder: Path) -> Simulator:
    from simgap.simulators.mujoco_joints import MuJoCoJoints

    return _with_memory(case, folder, MuJoCoJoints)


def _with_memory(case: Case, folder: Path, engine: Callable[[JointPlant, Any], Simulator]) -> Simulator:
    """The engine itself, or, where an input is delayed or lags, the engine a step at a time behind its commands."""
    section: Any = case.simulator
    plant = joint_plant(case, folder)
    lags = [plant.input_names.index(s.lag_of) for s in case.plant.states.values() if s.lag_of is not None]
    lagging = {e.on for e in section.effects if effect(e.name).memory_state(e.on) is not None}
    if not {plant.input_names[k] for k in lags} <= lagging:
        raise UserError(
            "a lagged input is a state of the plant, but does not lag in the simulator", key="simulator.effects",
            remedy="Add its lag to simulator.effects too, or remove the state.",
        )  # fmt: skip
    if not any(effect(e.name).remembers for e in section.effects):
        return engine(plant, section)
    paths = _command_paths(case)
    others = tuple(e for e in section.effects if not isinstance(effect(e.name), InputEffect))
    a_step = replace(plant, tau=plant.tau / section.substeps)
    bare = engine(a_step, section.model_copy(update={"substeps": 1, "effects": others}))
    return RememberingInputs(bare, paths, lags, plant.tau, section.substeps)


def _command_paths(case: Case) -> list[CommandPath]:
    """The ways of the commands; the delay that the controller has as its latency is not acted out a second time."""
    if case.domain is None:
        raise UserError("the simulator needs a domain", key="domain", remedy="Add `domain:`.")
    known = case.domain.tau * case.sensing.known_delay if case.sensing else 0.0
    values = {name: case.domain.U[name].list().tolist() for name in case.plant.inputs}
    effects = case.simulator.effects if case.simulator is not None else ()
    return command_paths(effects, values, known)


def _pybullet_wheeled(case: Case, folder: Path) -> Simulator:
    from simgap.simulators.wheeled import PyBulletWheeled, wheeled_plant

    section: Any = case.simulator
    plant = wheeled_plant(case, folder)
    return PyBulletWheeled(plant, section, _command_paths(case) if section.effects else ())


ENGINES: Mapping[str, Callable[[Case, Path], Simulator]] = {
    "pybullet": _pybullet,
    "pybullet_wheeled": _pybullet_wheeled,
    "mujoco": _mujoco,
}


def make_simulator(case: Case, folder: Path) -> Simulator:
    """The simulator that a case declares; call it in the process that will run it.

    Raises:
        UserError: no `simulator` section, or an engine that is not known.
    """
    if case.simulator is None:
        raise UserError("this stage needs a simulator", key="simulator", remedy="Add `simulator:`.")
    engine = case.simulator.engine
    if engine not in ENGINES:
        raise UserError(f"no engine '{engine}'", key="simulator.engine", remedy=f"Known: {', '.join(ENGINES)}.")
    return ENGINES[engine](case, folder)
