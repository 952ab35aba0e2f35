"""Numbers of a URDF, link by link and joint by joint, to compare with an engine's own, and its end stops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.plants.urdf_checks import check_urdf


@dataclass(frozen=True, eq=False)
class Link:
    """One link: mass, kg; moments (3,), principal and ascending, kg m^2; com (3,), in its frame, m."""

    mass: float
    moments: Floats
    com: Floats


@dataclass(frozen=True)
class FileJoint:
    """A joint that moves. Limits are None where the file states none; the others are 0.

    Attributes:
        kind: revolute, continuous, prismatic, ...
        range: lower and upper end, rad or m; effort, velocity: largest allowed, N m or N, rad/s or m/s.
        damping, friction: of `<dynamics>`. mimics: the joint that it follows.
        reflected: whether the file states a rotor's inertia or a gear ratio for it.
    """

    kind: str
    range: tuple[float, float] | None
    effort: float | None
    velocity: float | None
    damping: float
    friction: float
    mimics: str | None
    reflected: bool


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A URDF as it is written.

    Attributes:
        bare: links without `<inertial>` that are part of what moves. meshes: named files.
        driven: joints that some `<transmission>` joins to an actuator; None for a file without one.
    """

    path: Path
    links: Mapping[str, Link]
    bare: tuple[str, ...]
    joints: Mapping[str, FileJoint]
    meshes: tuple[str, ...]
    driven: tuple[str, ...] | None


def read_model_file(path: Path, meshes: bool = True) -> ModelFile:
    """The numbers of a URDF; `meshes` as in `check_urdf`.

    Raises:
        UserError: what `check_urdf` refuses.
    """
    check_urdf(path, meshes)
    robot = reading.read_xml(path)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    weighed = {name: _link(link) for name, link in links.items() if link.find("inertial/mass") is not None}
    geared = {str(j.get("name")) for t in robot.findall("transmission") for j in t.findall("joint") if _geared(t)}
    joints = {str(j.get("name")): _joint(j, geared) for j in robot.findall("joint") if j.get("type") != "fixed"}
    bare = tuple(name for name in _carried(robot) if name not in weighed)
    named = tuple(dict.fromkeys(str(mesh.get("filename")) for mesh in robot.iter("mesh")))
    geared_to = [str(j.get("name")) for t in robot.findall("transmission") for j in t.findall("joint")]
    driven = tuple(name for name in joints if name in geared_to) if geared_to else None
    return ModelFile(path, weighed, bare, joints, named, driven)


def _carried(robot: ElementTree.Element) -> list[str]:
    """Links that some joint moves, by itself or through fixed ones."""
    moved: list[str] = []
    ends = [(j.get("type"), j.find("parent"), j.find("child")) for j in robot.findall("joint")]
    pairs = [(kind, str(a.get("link")), str(b.get("link"))) for kind, a, b in ends if a is not None and b is not None]
    while True:
        more = [c for kind, p, c in pairs if (kind != "fixed" or p in moved) and c not in moved]
        if not more:
            return moved
        moved += more


def _link(link: ElementTree.Element) -> Link:
    mass, inertia, origin = (link.find(f"inertial/{tag}") for tag in ("mass", "inertia", "origin"))
    ixx, iyy, izz, ixy, ixz, iyz = (
        0.0 if inertia is None else float(inertia.get(name, "0")) for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    moments = np.linalg.eigvalsh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))
    com = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
    return Link(
        0.0 if mass is None else float(mass.get("value", "0")), moments, np.array([float(v) for v in com.split()])
    )


def _joint(joint: ElementTree.Element, geared: set[str]) -> FileJoint:
    limit, dynamics, mimic = (joint.find(tag) for tag in ("limit", "dynamics", "mimic"))
    lower, upper, effort, velocity = (_limit(limit, key) for key in ("lower", "upper", "effort", "velocity"))
    kind = str(joint.get("type"))
    bounded = kind != "continuous" and lower is not None and upper is not None
    return FileJoint(
        kind=kind,
        range=(lower, upper) if bounded and lower is not None and upper is not None else None,
        effort=effort,
        velocity=velocity,
        damping=0.0 if dynamics is None else float(dynamics.get("damping", "0")),
        friction=0.0 if dynamics is None else float(dynamics.get("friction", "0")),
        mimics=None if mimic is None else str(mimic.get("joint")),
        reflected=str(joint.get("name")) in geared,
    )


def _limit(limit: ElementTree.Element | None, key: str) -> float | None:
    text = None if limit is None else limit.get(key)
    return None if text is None else float(text)


def _geared(transmission: ElementTree.Element) -> bool:
    """True if a transmission states a gear ratio other than 1, or a rotor's inertia."""
    tags = {part.tag: part for part in transmission.iter()}
    ratio = (tags["mechanicalReduction"].text or "1") if "mechanicalReduction" in tags else "1"
    return ratio.strip() not in ("1", "1.0") or any("rotor_inertia" in t or "gear_ratio" in t for t in tags)


_STOPPED = ("revolute", "prismatic")


def joint_stops(urdf: Path, joints: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Finite limits of the position of each of these joints, in rad or m; none for a continuous one.

    The file is one that `urdf_checks.check_urdf` has taken.
    """
    found = {}
    for joint in reading.read_xml(urdf).findall("joint"):
        limit = joint.find("limit")
        if joint.get("name") in joints and joint.get("type") in _STOPPED and limit is not None:
            ends = [float(limit.get(end, "0")) for end in ("lower", "upper")]
            found[str(joint.get("name"))] = tuple(sorted({end for end in ends if math.isfinite(end)}))
    return {name: found.get(name, ()) for name in joints}
