"""A URDF, read by Drake, as a `Tree`: joints in their order, welded links as parts of the body that carries them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.model.tree import Tree, moved
from simgap.plants.urdf import multibody_plant


def load_tree(path: Path, gravity: float = 9.81) -> Tree:
    """The moving joints and bodies of a file that `urdf_checks.check_urdf` has taken.

    Args:
        path: the URDF; its root link is welded to the world.
        gravity: acceleration along -z, m/s^2.

    Raises:
        UserError: a joint other than a hinge or a slide.
    """
    plant, names = multibody_plant(path, (0.0, 0.0, -gravity))
    joints = [plant.GetJointByName(name) for name in names]
    context = plant.CreateDefaultContext()
    poses = {joint.child_body().name(): _pose(plant, context, joint.child_body()) for joint in joints}
    carried = {body.name(): k for k, j in enumerate(joints) for body in plant.GetBodiesWeldedTo(j.child_body())}
    parent, turn, place, inertial = [], [], [], np.zeros((len(joints), 10))
    for k, joint in enumerate(joints):
        up = joint.parent_body()
        parent.append(carried.get(up.name(), -1))
        base = poses[joints[parent[k]].child_body().name()] if parent[k] >= 0 else (np.eye(3), np.zeros(3))
        own = _at_zero(plant, context, joint)
        turn.append(base[0].T @ own[0])
        place.append(base[0].T @ (own[1] - base[1]))
        for body in plant.GetBodiesWeldedTo(joint.child_body()):
            other, mine = _pose(plant, context, body), poses[joint.child_body().name()]
            inertial[k] += moved(_parameters(body), mine[0].T @ other[0], mine[0].T @ (other[1] - mine[1]))
    return Tree(
        joints=tuple(names),
        links=tuple(j.child_body().name() for j in joints),
        parent=np.array(parent, dtype=np.int64),
        turn=np.array(turn),
        place=np.array(place),
        axis=np.array([_axis(j) for j in joints]),
        slides=np.array([j.type_name() == "prismatic" for j in joints]),
        inertial=inertial,
        damping=np.array([float(j.default_damping()) for j in joints]),
        gravity=np.array([0.0, 0.0, -gravity]),
    )


def _axis(joint: Any) -> Floats:
    axis = joint.revolute_axis() if joint.type_name() == "revolute" else joint.translation_axis()
    return np.array(axis, dtype=np.float64)


def _pose(plant: Any, context: Any, body: Any) -> tuple[Floats, Floats]:
    pose = plant.EvalBodyPoseInWorld(context, body)
    return np.array(pose.rotation().matrix()), np.array(pose.translation())


def _at_zero(plant: Any, context: Any, joint: Any) -> tuple[Floats, Floats]:
    """Pose in the world of the joint's frame on its parent, which at position 0 is that of the body that it moves."""
    pose = joint.frame_on_parent().CalcPoseInWorld(context)
    return np.array(pose.rotation().matrix()), np.array(pose.translation())


def _parameters(body: Any) -> Floats:
    inertia = body.default_spatial_inertia()
    m, com = inertia.get_mass(), np.array(inertia.get_com())
    tensor = inertia.CalcRotationalInertia().CopyToFullMatrix3()  # about the body frame's origin: its joint
    return np.concatenate([[m], m * com, tensor[np.triu_indices(3)]])
