"""An MJCF file as the nominal model of a new case: the bodies that MuJoCo compiles, as a URDF, some joints locked.

What a URDF cannot say of a joint, its armature and its spring, is handed back as effects of the plant.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from simgap.arrays import Floats
from simgap.effects import joint_effect
from simgap.errors import UserError, excerpt
from simgap.extras.wizard.model_file import (
    Asked,
    NewModel,
    check_base,
    check_positions,
    named_joints,
    origin_of,
    write_model,
)
from simgap.io.atomic import write_text
from simgap.io.urdf_file import write_inertial
from simgap.late import scipy
from simgap.model.tree import moved
from simgap.plants.model_file import base_of
from simgap.plants.urdf_checks import loading
from simgap.simulators import mjcf
from simgap.simulators.findings import most_force, motors_of

_DELETED = (
    "actuators", "sensors", "keys", "pairs", "excludes", "tendons", "equalities", "geoms", "sites", "cameras", "lights",
    "meshes", "hfields", "skins", "materials", "textures",
)  # fmt: skip
_SAME, _LEVEL = 1e-6, 1e-4
"""Relative difference of mass matrices that is rounding, and slope of a gravity that is along -z."""


def model_of_mjcf(path: Path, asked: Asked) -> NewModel:
    """A URDF of the bodies as MuJoCo compiles them; the simulator loads the file, or one without what inputs replace.

    Raises:
        UserError: a file that MuJoCo does not take, what no URDF says (a base that moves freely, several joints of one
            body, closed chains, tendons, gravity along another axis), and as `model_of_urdf`.
    """
    model = mjcf.read_mjcf(path)
    names = [model.joint(k).name for k in range(model.njnt)]
    driven = [n for k, n in enumerate(names) if next(motors_of(model, k), None) is not None]
    turning = _turning(path, model, names, driven, asked.base == "fixed")
    left = named_joints(turning if asked.joints is None else asked.joints, turning, "--joints")
    named_joints(asked.at or turning, turning, "--at")
    whole = len(left) == len(names)
    _check_loops(path, model, left, whole)
    efforts = {n: most_force(model, names.index(n)) for n in left}
    alone, left_out = None, ""
    if not whole or _acting(model):
        left_out = "; ".join(_left_out(model, left))
        model, alone = _alone(path, left, asked.at)
    gravity = mjcf.gravity_of(model)
    if np.abs(gravity[:2]).max() > _LEVEL * np.abs(gravity[2]):
        raise UserError("its gravity is not along -z", file=path, key="<option> gravity", remedy="Turn the bodies.")
    robot, made = _robot(path, model, efforts), asked.beside(".urdf")
    own = asked.beside(".xml") if alone is not None else path
    file = replace(write_model(made, robot), driven=tuple(n for n in left if n in driven) or None)
    check_positions(file.joints, {n: q for n, q in asked.at.items() if n in file.joints})
    check_base(path, base_of(robot, file.driven, world=False), asked.base)
    if alone is not None:
        write_text(own, alone)
        asked.note(f"{own.name} is {path.name} without {left_out}.")
    asked.note(f"{made.name} has the bodies as MuJoCo compiles them, for the nominal model.")
    return NewModel(file, own, tuple(_effects(model)), 0.0 - float(gravity[2]), float(model.opt.timestep))


def _turning(path: Path, model: Any, names: Sequence[str], driven: Collection[str], bolted: bool) -> list[str]:
    """The hinges and slides of a file, without those by which a base moves freely, which nothing drives.

    Raises:
        UserError: a base that moves freely and is not `bolted`, no hinge or slide, or a joint without a name.
    """
    mujoco = mjcf.require_mujoco()
    kinds = [mujoco.mjtJoint(int(k)) for k in model.jnt_type]
    wrapped = model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_JOINT]
    idle = [k for k, n in enumerate(names) if n not in driven and k not in wrapped]  # no motor, and on no tendon
    slides = [k for k in idle if kinds[k] == mujoco.mjtJoint.mjJNT_SLIDE]
    bodies = [int(model.jnt_bodyid[k]) for k in slides]
    planar = {b for b in bodies if bodies.count(b) > 1}
    turning = [
        n for k, n in enumerate(names)
        if _turns_or_slides(model, k) and (k not in idle or model.jnt_bodyid[k] not in planar)
    ]  # fmt: skip
    loose = next((k for k, n in enumerate(names) if n not in turning), None)
    if loose is not None and not bolted:
        kind = kinds[loose].name.removeprefix("mjJNT_").lower()
        raise UserError(
            f"joint '{excerpt(names[loose], 40)}' is {kind}{' and nothing drives it' * (loose in slides)}: a "
            "base or a body that moves freely", file=path, key="--base",
            remedy="--base fixed locks it; a floating base needs equations of its own.",
        )  # fmt: skip
    if not turning:
        raise UserError("has no hinge or slide", file=path, remedy="Give the model of a robot that moves.")
    if not all(n for k, n in enumerate(names) if k != loose):
        raise UserError("a joint has no name", file=path, remedy="Name every joint.")
    return turning


def _check_loops(path: Path, model: Any, left: Collection[str], whole: bool) -> None:
    """Refuse constraints that couple joints, which no tree has; where all but some are locked, those of these alone."""
    mujoco = mjcf.require_mujoco()
    for k in range(model.neq):
        kind = mujoco.mjtEq(int(model.eq_type[k]))
        ends = {int(model.eq_obj1id[k]), int(model.eq_obj2id[k])}
        if kind == mujoco.mjtEq.mjEQ_JOINT and not ends & {model.joint(name).id for name in left}:
            continue
        couples = kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON)
        raise UserError(
            f"<equality> {kind.name[5:].lower()} {'couples joints, as mimic does' if couples else 'closes a chain'}, "
            "and the nominal model has neither", file=path,
            remedy="--joints keeps others." if couples else "Open the chain, or write equations.",
        )  # fmt: skip
    if whole and model.ntendon:
        raise UserError("it has tendons", file=path, remedy="--joints keeps some joints and leaves the tendons out.")
    bodies = [model.jnt_bodyid[model.joint(name).id] for name in left]
    twice = next((b for b in bodies if bodies.count(b) > 1), None)
    if twice is not None:
        names = [n for n, b in zip(left, bodies, strict=True) if b == twice]
        raise UserError(
            f"has several joints ({', '.join(names)}): a URDF has one a body, and between them bodies without mass",
            file=path, key=f"body '{excerpt(model.body(int(twice)).name, 40)}'",
            remedy="--joints keeps one of them, or give each joint a body.",
        )  # fmt: skip


def _acting(model: Any) -> bool:
    """True if its actuators do anything without a command, or have a state of their own."""
    own = (model.actuator_biasprm, model.actuator_dyntype, getattr(model, "actuator_armature", 0.0),
           getattr(model, "actuator_damping", 0.0))  # fmt: skip
    return bool(model.na) or any(np.any(values) for values in own)


def _left_out(model: Any, left: Sequence[str]) -> Iterator[str]:
    if locked := model.njnt - len(left):
        yield f"{locked} joint{'s' * (locked > 1)}, locked"
    if _acting(model):
        gains = [
            f"{name} kp = {0.0 - model.actuator_biasprm[k, 1]:g} kv = {0.0 - model.actuator_biasprm[k, 2]:g}"
            for name in left for k in motors_of(model, model.joint(name).id) if np.any(model.actuator_biasprm[k])
        ]  # fmt: skip
        yield f"servos ({', '.join(gains) or 'no gains'}), for the inputs of the case are forces on joints"
    if model.ntendon:
        yield "tendons"
    if model.ngeom:
        yield "shapes, which do not touch there"


def _alone(path: Path, left: Collection[str], at: Mapping[str, float]) -> tuple[Any, str]:
    """The bodies of a file with their inertias, and those joints; nothing else. Checked by the mass matrix."""
    mujoco = mjcf.require_mujoco()
    with loading("MuJoCo", path):
        spec = mujoco.MjSpec.from_file(str(path))
        whole = spec.compile()
    data = mujoco.MjData(whole)
    for body in spec.bodies[1:]:
        k = body.id
        body.mass, body.explicitinertial = float(whole.body_mass[k]), True
        body.ipos, body.iquat, body.inertia = whole.body_ipos[k], whole.body_iquat[k], whole.body_inertia[k]
        body.fullinertia, body.pos, body.quat = [np.nan] * 6, whole.body_pos[k], whole.body_quat[k]
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for kind in _DELETED:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for joint, j in [(joint, joint.id) for joint in spec.joints]:  # ids change as others are deleted
        if joint.name in left:
            continue
        if _turns_or_slides(whole, j):
            start = whole.qpos0[whole.jnt_qposadr[j]]
            lower, upper = whole.jnt_range[j] if whole.jnt_limited[j] else (-np.inf, np.inf)
            place = at.get(joint.name, 0.0 if lower <= 0.0 <= upper else 0.5 * (lower + upper))
            data.qpos[whole.jnt_qposadr[j]] = place
            _turn(joint.parent, whole, j, place - start)
        spec.delete(joint)
    with loading("MuJoCo", path):
        model, text = spec.compile(), spec.to_xml()
    held = [int(whole.joint(name).dofadr[0]) for name in left]
    data.qpos[[int(whole.joint(n).qposadr[0]) for n in left]] = [
        model.qpos0[int(model.joint(n).qposadr[0])] for n in left
    ]
    mine, own = (_mass_matrix(mujoco, m, d) for m, d in ((whole, data), (model, mujoco.MjData(model))))
    order = [int(model.joint(name).dofadr[0]) for name in left]
    if not np.allclose(mine[np.ix_(held, held)], own[np.ix_(order, order)], rtol=_SAME, atol=0.0):
        raise UserError(
            "its joints cannot be locked there: others of the same bodies move them", file=path, key="--joints",
            remedy="Lock them in the file.",
        )  # fmt: skip
    return model, text


def _mass_matrix(mujoco: Any, model: Any, data: Any) -> Floats:
    mujoco.mj_forward(model, data)
    columns = np.zeros((model.nv, model.nv))
    for k in range(model.nv):
        mujoco.mj_mulM(model, data, columns[k], np.eye(model.nv)[k])
    return columns


def _turns_or_slides(model: Any, joint: int) -> bool:
    kinds = mjcf.require_mujoco().mjtJoint
    return kinds(int(model.jnt_type[joint])) in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE)


def _turn(body: Any, model: Any, joint: int, by: float) -> None:
    """A body's pose after its joint has moved."""
    old = _rotation(body.quat)
    new, shift = _motion(model, joint, by)
    body.pos = np.asarray(body.pos) + old.apply(shift)
    body.quat = (old * new).as_quat(scalar_first=True)


def _rotation(quaternion: Floats) -> scipy.spatial.transform.Rotation:
    return scipy.spatial.transform.Rotation.from_quat(quaternion, scalar_first=True)


def _motion(model: Any, joint: int, by: float) -> tuple[scipy.spatial.transform.Rotation, Floats]:
    """Rotation and shift of a body in its own frame as a joint moves by so much."""
    axis, anchor = np.array(model.jnt_axis[joint]), np.array(model.jnt_pos[joint])
    if model.jnt_type[joint] == mjcf.require_mujoco().mjtJoint.mjJNT_SLIDE:
        return scipy.spatial.transform.Rotation.identity(), by * axis
    turned = scipy.spatial.transform.Rotation.from_rotvec(by * axis)
    return turned, anchor - turned.apply(anchor)


def _robot(path: Path, model: Any, efforts: Mapping[str, float | None]) -> ElementTree.Element:
    """Links have their frames where their joints are; what MuJoCo places in a body's frame is moved along."""
    robot = ElementTree.Element("robot", {"name": path.stem})
    names = ["world", *(model.body(k).name or f"body{k}" for k in range(1, model.nbody))]
    anchors = np.zeros((model.nbody, 3))
    ElementTree.SubElement(robot, "link", {"name": "world"})
    for b in range(1, model.nbody):
        moving = int(model.body_jntadr[b]) if model.body_jntnum[b] else None
        turned, place = _rotation(model.body_quat[b]), np.array(model.body_pos[b])
        if moving is not None:
            anchors[b] = model.jnt_pos[moving]
            back, shift = _motion(model, moving, -float(model.qpos0[model.jnt_qposadr[moving]]))
            place = place + turned.apply(shift + back.apply(anchors[b]))
            turned = turned * back
        _link(robot, names[b], model, b, anchors[b])
        name = f"{names[b]}_weld" if moving is None else model.joint(moving).name
        joint = ElementTree.SubElement(robot, "joint", {"name": name, "type": "fixed"})
        joint.append(origin_of(place - anchors[model.body_parentid[b]], turned))
        ElementTree.SubElement(joint, "parent", {"link": names[model.body_parentid[b]]})
        ElementTree.SubElement(joint, "child", {"link": names[b]})
        if moving is not None:
            _moves(joint, model, moving, efforts[name])
    return robot


def _link(robot: ElementTree.Element, name: str, model: Any, b: int, anchor: Floats) -> None:
    link = ElementTree.SubElement(robot, "link", {"name": name})
    xx, yy, zz = model.body_inertia[b]
    along_its_axes = np.array([model.body_mass[b], 0.0, 0.0, 0.0, xx, 0.0, 0.0, yy, 0.0, zz])
    turned = _rotation(model.body_iquat[b]).as_matrix()
    write_inertial(link, moved(along_its_axes, turned, model.body_ipos[b] - anchor))


def _moves(joint: ElementTree.Element, model: Any, j: int, effort: float | None) -> None:
    slides = model.jnt_type[j] == mjcf.require_mujoco().mjtJoint.mjJNT_SLIDE
    dof, limited = int(model.jnt_dofadr[j]), bool(model.jnt_limited[j])
    joint.set("type", "prismatic" if slides else "revolute" if limited else "continuous")
    ElementTree.SubElement(joint, "axis", {"xyz": " ".join(f"{v:.12g}" for v in model.jnt_axis[j])})
    limit = dict(zip(("lower", "upper"), model.jnt_range[j], strict=True)) if limited else {}
    limit |= {} if effort is None else {"effort": effort}
    if limit:
        ElementTree.SubElement(joint, "limit", {key: f"{value:.12g}" for key, value in limit.items()})
    own = {"damping": model.dof_damping[dof], "friction": model.dof_frictionloss[dof]}
    ElementTree.SubElement(joint, "dynamics", {key: f"{value:.12g}" for key, value in own.items()})


def _effects(model: Any) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    for j in range(model.njnt):
        about_0 = model.qpos_spring[model.jnt_qposadr[j]] == 0.0
        spring = model.jnt_stiffness[j] if about_0 else 0.0
        for attribute, value in (("armature", model.dof_armature[model.jnt_dofadr[j]]), ("stiffness", spring)):
            own = joint_effect(attribute)
            if value > 0.0:
                yield own.name, model.joint(j).name, {own.parameters[0].symbol: float(value)}
