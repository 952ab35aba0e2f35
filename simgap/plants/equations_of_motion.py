"""The equations of motion of a rigid-body tree, written out in its joints and inertial parameters.

With T_b(q) the pose of body b, 4 x 4, and P_b its pseudo-inertia, kinetic energy is the sum over bodies of
tr(dT_b/dt P_b (dT_b/dt)') / 2. Hence, with D_i = dT_b/dq_i (Uicker (1969), J. Applied Mechanics 36(2)):

    M_ij = sum_b tr(D_i P_b D_j'),   C v = sum_b tr(D_i P_b A_b'),  A_b = sum_jk v_j v_k d^2 T_b / dq_j dq_k,

and gravity's force on joint i is the sum of g' D_i P_b e_4. All are linear in masses, first moments and inertias, and
no quotient appears: expanded, an arm of two joints has 40 terms an entry at most, and as numbers take the place of its
parameters they fall together to a few. Drake gives poses and parameters; `drake_check` compares the accelerations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.late import sympy as sp
from simgap.model.simplified import simplified
from simgap.model.symbolic import symbol

MOST_SIMPLIFIED = 250
"""Operations of M, C v and the weight for which SymPy looks for shorter forms. A two-link arm has 121, which takes 4 s;
a Panda's second and fourth joint 665, for which it takes minutes and finds nothing that numbers need."""
_DIGITS = 11
_HOME = sp.Matrix([[0, 0, 0, 1]])


def derive_accelerations(
    plant: Any, joints: Sequence[str], order: Sequence[str], rates: Sequence[str],
    inertias: Mapping[str, Mapping[str, sp.Expr]], gravity: Sequence[str],
) -> tuple[sp.Matrix, sp.Matrix]:  # fmt: skip
    """M(q)^-1, and the acceleration without forces, M^-1 (weight - C(q, v) v).

    Args:
        plant: Drake's, with `joints` as its moving ones; `order` and `rates` name their positions and velocities.
        inertias: of each body that moves `m`, `cx` ... and `Ixx` ... about its own frame, 0 for what it has not.
        gravity: names of the components of gravity in the world.
    """
    q, v, n = [symbol(name) for name in order], [symbol(name) for name in rates], len(order)
    poses = _poses(plant, dict(zip(joints, q, strict=True)))
    mass, bias, weight = sp.zeros(n, n), sp.zeros(n, 1), sp.zeros(n, 1)
    pull = sp.Matrix([[*map(symbol, gravity), 0]])
    for body, own in inertias.items():
        inertia, slopes = _pseudo_inertia(own), [poses[body].diff(s) for s in q]
        turning = sp.zeros(4, 4)
        for slope, mine in zip(slopes, v, strict=True):
            for s, other in zip(q, v, strict=True):
                turning += slope.diff(s) * mine * other
        for i, slope in enumerate(slopes):
            moved = slope * inertia
            weight[i] += (pull * moved[:, 3])[0]
            bias[i] += (moved * turning.T).trace()
            for j, other_slope in enumerate(slopes):
                mass[i, j] += (moved * other_slope.T).trace()
    squares = {sp.sin(s) ** 2: 1 - sp.cos(s) ** 2 for s in q}
    mass, bias, weight = (
        m.applyfunc(lambda e: sp.expand(sp.expand(e).xreplace(squares))) for m in (mass, bias, weight)
    )
    if sum(int(sp.count_ops(e)) for m in (mass, bias, weight) for e in m) > MOST_SIMPLIFIED:
        inverse = mass.inv(method="ADJ")
        return inverse, inverse * (weight - bias)
    mass, bias, weight = (simplified(m, _shortest, "urdf 2") for m in (mass, bias, weight))
    inverse = simplified(mass, lambda m: _shortest(m.inv(method="ADJ")), "inverse 2")
    return inverse, simplified(inverse * (weight - bias), _shortest, "urdf 2")


def _shortest(matrix: sp.Matrix) -> sp.Matrix:
    return matrix.applyfunc(sp.simplify)


def _pseudo_inertia(own: Mapping[str, sp.Expr]) -> sp.Matrix:
    """The second moments of a body's mass, 4 x 4, from its mass, its centre and its inertia about its frame."""
    inertia = sp.Matrix(3, 3, lambda i, j: own["I" + "xyz"[min(i, j)] + "xyz"[max(i, j)]])
    first = own["m"] * sp.Matrix([own["cx"], own["cy"], own["cz"]])
    second = inertia.trace() / 2 * sp.eye(3) - inertia
    return second.row_join(first).col_join(first.T.row_join(sp.Matrix([[own["m"]]])))


def _poses(plant: Any, positions: Mapping[str, sp.Symbol]) -> dict[str, sp.Matrix]:
    """The pose in the world of each body that hangs on it, 4 x 4, by the positions of the joints that move."""
    found = {plant.world_body().name(): sp.eye(4)}
    left = [plant.get_joint(k) for k in plant.GetJointIndices()]
    while left:
        joint = next(j for j in left if j.parent_body().name() in found)
        left.remove(joint)
        motion = _motion(joint, positions[joint.name()]) if joint.num_velocities() else sp.eye(4)
        up = _exact(joint.frame_on_parent().GetFixedPoseInBodyFrame())
        down = _inverse(_exact(joint.frame_on_child().GetFixedPoseInBodyFrame()))
        pose = found[joint.parent_body().name()] * up * motion * down
        found[joint.child_body().name()] = pose.applyfunc(sp.expand)
    return found


def _motion(joint: Any, q: sp.Symbol) -> sp.Matrix:
    """What a hinge or a slide does, 4 x 4."""
    from pydrake.math import RigidTransform, RotationMatrix

    if joint.type_name() == "prismatic":
        return sp.eye(3).row_join(q * _rational(joint.translation_axis())).col_join(_HOME)
    turned = _exact(RigidTransform(RotationMatrix.MakeFromOneVector(joint.revolute_axis(), 2)))
    about_z = sp.Matrix([[sp.cos(q), -sp.sin(q), 0], [sp.sin(q), sp.cos(q), 0], [0, 0, 1]])
    return turned * about_z.row_join(sp.zeros(3, 1)).col_join(_HOME) * _inverse(turned)


def _exact(pose: Any) -> sp.Matrix:
    """A pose in rationals whose rotation is orthogonal without rounding, 4 x 4: that of a rational quaternion.

    Were it not, motion would depend in its last digits on where the base stands. The quaternion has _DIGITS
    digits, for files write a right angle as 1.57079632679, and what remains of it would be terms of 1e-12.
    """
    wxyz = np.array(pose.rotation().ToQuaternion().wxyz())
    w, x, y, z = _rational(np.round(wxyz / wxyz[np.argmax(np.abs(wxyz))], _DIGITS))
    turned = sp.Matrix([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])  # fmt: skip
    return (turned / (w * w + x * x + y * y + z * z)).row_join(_rational(pose.translation())).col_join(_HOME)


def _inverse(pose: sp.Matrix) -> sp.Matrix:
    back = pose[:3, :3].T
    return back.row_join(-back * pose[:3, 3]).col_join(_HOME)


def _rational(values: Any) -> sp.Matrix:
    return sp.Matrix([sp.nsimplify(float(v), rational=True) for v in values])
