"""MuJoCo: its models, and files of its own format, MJCF, as they stand but for the length of a step.

A motion that diverges is refused. Left to itself MuJoCo puts what diverges back where it began and goes on: `mj_step`
resets its data when a position, velocity or acceleration is no number or beyond 1e10, prints a line into a file
MUJOCO_LOG.TXT of the folder, and the step that follows looks like any other. Here the reset is off and the counters of
these warnings are asked after each sampling time.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.named_files import named_by
from simgap.errors import UserError, excerpt, optional
from simgap.plants.model_file import Link
from simgap.plants.urdf_checks import TRUST, check_units, inside, loading
from simgap.simulators.base import domain_of


class MuJoCoModel:
    """A compiled model, and its data, which a step changes.

    Attributes:
        mujoco: the module. engine: MuJoCo with its version.
    """

    def __init__(self, model: Any) -> None:
        """Let what diverges stay as it is, and MuJoCo write no file about it."""
        self.mujoco, self.model = require_mujoco(), model
        self.engine = f"mujoco {self.mujoco.__version__}"
        model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.mujoco.set_mju_user_warning(_silent)
        self.data = self.mujoco.MjData(model)
        kinds = self.mujoco.mjtWarning
        # how often a position, velocity or acceleration was bad since the last reset: a view, (3,)
        self._bad = self.data.warning.number[int(kinds.mjWARN_BADQPOS) : int(kinds.mjWARN_BADQACC) + 1]

    def reset(self) -> None:
        """Fresh data."""
        self.mujoco.mj_resetData(self.model, self.data)

    def step(self, count: int = 1) -> None:
        """So many engine steps."""
        self.mujoco.mj_step(self.model, self.data, count)

    def links(self, first: int) -> dict[str, Link]:
        """Bodies from number `first` on as MuJoCo computes with them; links on fixed joints are part of others."""
        m = self.model
        return {
            m.body(k).name: Link(float(m.body_mass[k]), np.sort(m.body_inertia[k]), np.array(m.body_ipos[k]))
            for k in range(first, m.nbody)
        }

    @property
    def has_diverged(self) -> bool:
        """True if something was bad since the last reset."""
        return any(self._bad)

    def diverged(self, engine: str, where: Iterable[tuple[str, float]]) -> UserError:
        """Error about what was bad.

        Args:
            engine: as in the case. where: names and values of state and input that the sampling time began with.
        """
        names = [n for n, bad in zip(("position", "velocity", "acceleration"), self._bad, strict=True) if bad]
        at = ", ".join(f"{name} = {value:.9g}" for name, value in where)
        problem = f"the engine '{engine}' diverges (no number, or beyond 1e10: {', '.join(names)}), at {at}"
        remedy = "Take more substeps, weaker effects or contacts, or leave the place out of domain.X and domain.U."
        return UserError(problem, key="simulator.substeps", remedy=remedy)


def _silent(text: str) -> None:
    """The counters say it."""


KEY = "simulator.mjcf"
TRIED = 50
"""States of X at which actuators are asked what they do without a command, and shapes whether they touch."""


def require_mujoco(key: str = "simulator.engine") -> Any:
    """The module `mujoco`.

    Raises:
        UserError: it is not there.
    """
    with optional("MuJoCo", "mujoco", key=key):
        import mujoco
    return mujoco


def read_mjcf(path: Path) -> Any:
    """MuJoCo's model of a file.

    Raises:
        UserError: a file that is not there or not MJCF, that names files outside its folders or some that no hash would
            see, or that MuJoCo does not take.
    """
    mujoco = require_mujoco()
    _check_root(path)
    named = dict(named_by(path))
    for name, place in named.items():
        if not inside(path, place):
            remedy = f"Put it beside the model, or trust it: set {TRUST}=1."
            raise UserError(f"'{excerpt(name, 60)}' lies outside the model's folders", file=path, remedy=remedy)
    with loading("MuJoCo", path):
        model = mujoco.MjModel.from_xml_path(str(path))
    known = {reading.real(place) for place in (path, *named.values())}
    needed = [Path(p) for p in mujoco.mju_getXMLDependencies(str(path)) if reading.is_file(Path(p))]
    unseen = [p for p in needed if reading.real(p) not in known]
    if unseen:
        problem = f"it depends on {excerpt(unseen[0], 80)} in a way that is not seen: an edit of it would rerun nothing"
        raise UserError(problem, file=path, remedy="Name it by <include>, or by the `file` of an asset.")
    return model


def gravity_of(model: Any) -> Floats:
    """Gravity with which MuJoCo moves a model, (3,), m/s^2: 0 where a `<flag>` switches it off."""
    off = model.opt.disableflags & require_mujoco().mjtDisableBit.mjDSBL_GRAVITY
    return np.zeros(3) if off else np.array(model.opt.gravity)


def _check_root(path: Path) -> None:
    if not reading.is_file(path):
        raise UserError("the model file does not exist", file=path, key=KEY, remedy="Correct its path.")
    root = reading.read_xml(path)
    if root.tag != "mujoco":
        problem = f"the root element is <{excerpt(root.tag, 40)}>, not <mujoco>"
        raise UserError(problem, file=path, key=KEY, remedy="A URDF is given as simulator.urdf.")


def check_mjcf(case: Case, folder: Path) -> Any:
    """The model of a case, once its joints are those of the case and no actuator works against the inputs.

    Raises:
        UserError: what `read_mjcf` refuses; joints that the file or the case lacks, or of more than one degree of
            freedom; units that are not the joints'; state beyond positions and velocities; an actuator with a force of
            its own.
    """
    path = folder / str(getattr(case.simulator, "mjcf", None))
    model, mujoco = read_mjcf(path), require_mujoco()
    kinds = {mujoco.mjtJoint.mjJNT_SLIDE.value: "prismatic", mujoco.mjtJoint.mjJNT_HINGE.value: "revolute"}
    found = {model.joint(k).name: kinds.get(int(model.jnt_type[k])) for k in range(model.njnt)}
    for name, kind in found.items():
        _check_joint(path, name, kind)
    check_units(case.plant, {name: str(kind) for name, kind in found.items()}, path.name)
    for name in found:
        _check_states(case, path, name)
    _check_roles(case)
    others = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS) - 1 - model.nq - model.nv
    if others:
        problem = f"beside positions and velocities the file has {others} states, as of an actuator's filter or a delay"
        remedy = "Remove them, and declare input_lag or input_delay in simulator.effects."
        raise UserError(problem, file=path, remedy=remedy)
    _check_unseen(path, model)
    _check_actuators(case, path, model)
    return model


def _check_unseen(path: Path, model: Any) -> None:
    """Refuse what moves the joints and is neither compared with the plant nor known to the samples."""
    motors = [getattr(model, name) for name in ("actuator_armature", "actuator_damping") if hasattr(model, name)]
    if model.ntendon or any(np.any(values) for values in motors):
        problem = "it has tendons, or motors with an armature or damping, which are compared with nothing"
        raise UserError(problem, file=path, remedy="Give these to the joints, or take them out.")


def _check_joint(path: Path, name: str, kind: str | None) -> None:
    if not name:
        raise UserError("a joint has no name", file=path, remedy="Name every joint.")
    if kind is None:
        problem = "a joint of more than one degree of freedom"
        remedy = "Weld the body by taking it out, or write it as hinges and slides."
        raise UserError(problem, file=path, key=f"joint '{excerpt(name, 40)}'", remedy=remedy)


def _check_states(case: Case, path: Path, joint: str) -> None:
    """A joint that the case does not know would be a hidden state."""
    for quantity in ("position", "velocity"):
        if not any(s.joint == joint and s.quantity == quantity for s in case.plant.states.values()):
            raise UserError(
                f"it moves, and no state of the case is its {quantity}", file=path, key=f"joint '{excerpt(joint, 40)}'",
                remedy=f"Give it one (plant.states.NAME: {{joint: {joint}, quantity: {quantity}}}), or take the joint "
                "out of the file, which welds its body.",
            )  # fmt: skip


def _check_roles(case: Case) -> None:
    """Refuse what equations leave open: which quantity of the file a state is, which joint an input pushes."""
    states = {n: s for n, s in case.plant.states.items() if s.lag_of is None and None in (s.quantity, s.joint)}
    inputs = [n for n, drive in case.plant.inputs.items() if drive.joint is None]
    for key in (*(f"states.{name}" for name in states), *(f"inputs.{name}" for name in inputs)):
        problem = "the file does not know it: it has no joint, or no quantity of one"
        remedy = "Write {joint: NAME, quantity: position or velocity}, for an input {joint: NAME}."
        raise UserError(problem, key=f"plant.{key}", remedy=remedy)


def samples(case: Case) -> list[dict[str, float]]:
    """States of X at which the model is asked: for each the value of every state, the middle first."""
    ends = domain_of(case).X
    rng = np.random.default_rng(0)
    middle = {name: 0.5 * (lo + hi) for name, (lo, hi) in ends.items()}
    return [middle, *({name: rng.uniform(lo, hi) for name, (lo, hi) in ends.items()} for _ in range(TRIED - 1))]


def data_at_state(case: Case, model: Any, x: dict[str, float]) -> Any:
    """MuJoCo's data at a state, everything computed that follows from it."""
    mujoco = require_mujoco()
    data = mujoco.MjData(model)
    for name, state in case.plant.states.items():
        if state.joint is not None:
            joint = model.joint(state.joint)
            place, k = (data.qpos, joint.qposadr) if state.quantity == "position" else (data.qvel, joint.dofadr)
            place[k] = x[name]
    mujoco.mj_forward(model, data)
    return data


def _check_actuators(case: Case, path: Path, model: Any) -> None:
    """The inputs are forces on joints; a servo in the file would hold the joint against them."""
    if case.domain is None:
        return
    for x in samples(case) if model.nu else ():
        force = data_at_state(case, model, x).actuator_force
        if force.any():
            name = model.actuator(int(np.flatnonzero(force)[0])).name
            problem = "it works without a command, against the inputs of the case, which are forces on joints"
            remedy = "Take it out, or make it a <motor>: a servo loop belongs into the controller."
            raise UserError(problem, file=path, key=f"actuator '{excerpt(name, 40)}'", remedy=remedy)
