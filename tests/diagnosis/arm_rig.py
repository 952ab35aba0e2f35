"""A six-joint arm of our own, moved and loaded by PyBullet: its inverse dynamics, and friction that is written here.

Nothing of the fit is used: the torques are the engine's for an analytic motion, plus friction by its definition.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
PLACES = ("0 0 0.3", "0 0.1 0.1", "0.5 0 0", "0.4 0 0.05", "0.1 0 0", "0.1 0 0")
MASSES = (6.0, 8.0, 5.0, 2.0, 1.5, 0.6)


def urdf(joints: int = 6, extra: float = 0.0) -> str:
    """The arm's URDF; `extra` kg more at the origin of the last link's tool, which a fixed joint carries."""
    text = '<robot name="rig"><link name="base"/>'
    for k in range(joints):
        parent = f"link{k}" if k else "base"
        m, i = MASSES[k], 0.02 * MASSES[k]
        text += (
            f'<link name="link{k + 1}"><inertial><origin xyz="{0.1 + 0.02 * k} 0.02 0.03"/><mass value="{m}"/>'
            f'<inertia ixx="{i}" iyy="{1.2 * i}" izz="{0.9 * i}" ixy="{0.1 * i}" ixz="0" iyz="{0.05 * i}"/>'
            "</inertial></link>"
            f'<joint name="joint{k + 1}" type="continuous"><parent link="{parent}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{PLACES[k]}"/><axis xyz="{AXES[k]}"/></joint>'
        )
    m = 0.4 + extra
    text += (
        f'<link name="tool"><inertial><origin xyz="0 0.01 0"/><mass value="{m}"/>'
        f'<inertia ixx="{1e-3 * m}" iyy="{1e-3 * m}" izz="{1e-3 * m}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="flange" type="fixed"><parent link="link{joints}"/><child link="tool"/>'
        '<origin xyz="0.08 0 0" rpy="0.3 0.2 0.1"/></joint></robot>'
    )
    return text


@dataclass(frozen=True)
class Friction:
    """Viscous and Coulomb friction and bias of each joint's torque."""

    viscous: np.ndarray
    coulomb: np.ndarray
    bias: np.ndarray


def motion(joints: int, seconds: float, rate: float, seed: int) -> tuple[np.ndarray, ...]:
    """A sum of five sines a joint: times (N,), positions, velocities, accelerations (N, n), exact."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate)
    q, v, a = (np.zeros((len(t), joints)) for _ in range(3))
    for j in range(joints):
        for w in 2.0 * np.pi * 0.1 * np.arange(1, 6):
            size, phase = rng.uniform(0.1, 0.5) / (0.5 + w), rng.uniform(0.0, 2.0 * np.pi)
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w**2 * np.sin(w * t + phase)
    return t, q, v, a


def torques(path: Path, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """PyBullet's inverse dynamics of a file, (N, n)."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
        body = pybullet.loadURDF(
            str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client
        )
        for link in range(-1, pybullet.getNumJoints(body, physicsClientId=client)):
            pybullet.changeDynamics(body, link, linearDamping=0, angularDamping=0, physicsClientId=client)
        rows = [
            pybullet.calculateInverseDynamics(body, list(x), list(y), list(z), physicsClientId=client)
            for x, y, z in zip(q.tolist(), v.tolist(), a.tolist(), strict=True)
        ]
    finally:
        pybullet.disconnect(client)
    return np.array(rows)


def rubbed(v: np.ndarray, friction: Friction) -> np.ndarray:
    """What the drives give on top: against friction, and less a bias that the joints feel anyway."""
    return friction.viscous * v + friction.coulomb * np.sign(v) - friction.bias


def write_csv(path: Path, t: np.ndarray, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> Path:
    """A recording: t, q1.., v1.., torque1.."""
    n = q.shape[1]
    names = ["t", *(f"{x}{k + 1}" for x in ("q", "v", "torque") for k in range(n))]
    np.savetxt(path, np.column_stack([t, q, v, torque]), delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path


def case(joints: int, measured: str) -> str:
    """The case of the arm as declared: no friction."""
    k = range(1, joints + 1)
    states = "".join(f"    q{i}: {{unit: rad, joint: joint{i}, quantity: position}}\n" for i in k)
    states += "".join(f"    v{i}: {{unit: rad/s, joint: joint{i}, quantity: velocity}}\n" for i in k)
    inputs = "".join(f"    torque{i}: {{unit: N*m, joint: joint{i}}}\n" for i in k)
    return f"name: rig\nplant:\n  urdf: rig.urdf\n  states:\n{states}  inputs:\n{inputs}measured:\n{measured}"
