"""A URDF as it is written: numbers of links and joints, to compare with an engine's own, end stops, base, and wheels.

A URDF has no word for its base: bolted to the world, on wheels or legs, or free. A controller of a quadruped that hangs
in the air is right for nothing, so `base_of` tells as far as the file shows it.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import excerpt
from simgap.late import scipy
from simgap.plants.urdf_checks import NUMBERS, attributes, check_urdf, ends, links_moved, mass_of, principal_moments


def numbers(part: ElementTree.Element, path: str, key: str, default: str = "0 0 0") -> Floats:
    """An attribute of several numbers of an element below a link or joint, or what stands for it."""
    return np.array([float(v) for v in attributes(part, path).get(key, default).split()])


def placed_at(part: ElementTree.Element, path: str = "origin") -> tuple[Floats, Any]:
    """Place (3,) and rotation of what an `<origin>` below a link or joint places."""
    return numbers(part, path, "xyz"), scipy.spatial.transform.Rotation.from_euler("xyz", numbers(part, path, "rpy"))


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


def read_model_file(path: Path, check: Callable[[Path], None] = check_urdf) -> ModelFile:
    """The numbers of a URDF.

    Raises:
        UserError: what `check` refuses, at least what `check_structure` does.
    """
    check(path)
    robot = reading.read_xml(path)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    weighed = {name: _link(link) for name, link in links.items() if link.find("inertial/mass") is not None}
    actuated = [(str(j.get("name")), _geared(t)) for t in robot.findall("transmission") for j in t.findall("joint")]
    geared = {name for name, reflected in actuated if reflected}
    joints = {str(j.get("name")): _joint(j, geared) for j in robot.findall("joint") if j.get("type") != "fixed"}
    bare = tuple(name for name in links_moved(robot) if name not in weighed)
    named = tuple(dict.fromkeys(str(mesh.get("filename")) for mesh in robot.iter("mesh")))
    driven = tuple(name for name in joints if name in dict(actuated)) if actuated else None
    return ModelFile(path, weighed, bare, joints, named, driven)


def _link(link: ElementTree.Element) -> Link:
    return Link(mass_of(link), principal_moments(link), numbers(link, "inertial/origin", "xyz"))


def _joint(joint: ElementTree.Element, geared: set[str]) -> FileJoint:
    limit, dynamics = attributes(joint, "limit"), attributes(joint, "dynamics")
    stated = {key: float(limit[key]) for key in NUMBERS["limit"] if key in limit}
    bounded = joint.get("type") != "continuous" and {"lower", "upper"} <= stated.keys()
    return FileJoint(
        kind=str(joint.get("type")),
        range=(stated["lower"], stated["upper"]) if bounded else None,
        effort=stated.get("effort"),
        velocity=stated.get("velocity"),
        damping=float(dynamics.get("damping", "0")),
        friction=float(dynamics.get("friction", "0")),
        mimics=attributes(joint, "mimic").get("joint"),
        reflected=str(joint.get("name")) in geared,
    )


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
        limit = attributes(joint, "limit")
        if joint.get("name") in joints and joint.get("type") in _STOPPED and limit:
            stops = {float(limit.get(end, "0")) for end in ("lower", "upper")}
            found[str(joint.get("name"))] = tuple(sorted(filter(math.isfinite, stops)))
    return {name: found.get(name, ()) for name in joints}


_ROUND = ("collision/geometry/cylinder", "collision/geometry/sphere")


@dataclass(frozen=True)
class Base:
    """Kind of base, as far as the file shows it, and the words that say why."""

    kind: Literal["fixed", "wheels", "limbs", "free"]
    words: str


@dataclass(frozen=True)
class _Joint:
    name: str
    kind: str
    child: str
    on: str | None  # the moving joint that carries it
    below: int  # moving joints that it carries, itself included


def base_of(robot: ElementTree.Element, driven: Collection[str] | None = None, world: bool = True) -> Base:
    """The base of a robot, whose file `urdf_checks.check_urdf` has taken.

    One chain of joints from the root, such as an arm with its gripper, is taken for bolted, as is what hangs on a link
    `world`; but not if the base outweighs all that it carries, as one that flies does. Several chains that begin at the
    root are legs, arms or fingers: of those the file does not tell.

    Args:
        driven: its joints that have a drive, where the file says so. world: whether a link `world` was meant as an
            anchor, and is not merely there.
    """
    joints = _moving(robot)
    loose = next((j for j in joints if j.kind in ("floating", "planar")), None)
    if loose is not None:
        return Base("free", f"joint '{excerpt(loose.name, 40)}' is {loose.kind}: a floating base")
    trunk, limbs = list[_Joint](), [j for j in joints if j.on is None]
    while len(limbs) == 1:
        trunk += limbs
        limbs = [j for j in joints if j.on == trunk[-1].name]
    slides = [j for j in trunk[:3] if j.kind == "prismatic"]
    if driven is not None and len(slides) > 1 and not {j.name for j in slides} & {*driven}:
        return Base("free", f"nothing drives {_named(slides)}, which carries everything else: a floating base")
    links = {link.get("name"): link for link in robot.findall("link")}
    tips = [j for j in joints if j.kind == "continuous" and j.below == 1]
    named = [j for j in tips if "wheel" in f"{j.name} {j.child}".lower()]
    wheels = named or [j for j in tips if any(links[j.child].find(shape) is not None for shape in _ROUND)]
    anchored = world and "world" in links and not slides
    if not anchored and (named or len(wheels) > 1):
        return Base("wheels", f"it has wheels ({_named(wheels)})")
    if not anchored and (not trunk or len(slides) > 1) and (len(limbs) > 2 or sum(j.below > 1 for j in limbs) > 1):
        return Base("limbs", f"{len(limbs)} chains of joints begin at its base ({_named(limbs)}), as legs do")
    base, carried = _masses(robot, joints)
    if world and not anchored and base > carried:
        words = f"its base weighs {base:.3g} kg and all that it carries {carried:.3g} kg"
        return Base("free", f"{words}, as a floating base does")
    return Base("fixed", "one chain of joints" if not anchored else "it hangs on a link `world`")


def _masses(robot: ElementTree.Element, joints: list[_Joint]) -> tuple[float, float]:
    """Mass of the root with what is fixed to it, and of all that it carries, kg."""
    above = {child: parent for parent, child in map(ends, robot.findall("joint"))}
    moved, base, carried = {j.child for j in joints}, 0.0, 0.0
    for link in robot.findall("link"):
        at, own = link.get("name", ""), mass_of(link)
        while at not in moved and at in above:
            at = above[at]
        base, carried = (base, carried + own) if at in moved else (base + own, carried)
    return base, carried


def _moving(robot: ElementTree.Element) -> list[_Joint]:
    """The joints that move, in the order of the file."""
    carried = {ends(j)[1]: j for j in robot.findall("joint")}
    found, below = list[tuple[ElementTree.Element, list[str]]](), Counter[str]()
    for joint in robot.findall("joint"):
        if joint.get("type") == "fixed":
            continue
        above, own = joint, list[str]()
        while (up := carried.get(ends(above)[0])) is not None:
            own += [up.get("name", "")] if up.get("type") != "fixed" else []
            above = up
        found.append((joint, own))
        below.update([joint.get("name", ""), *own])
    return [
        _Joint(name := j.get("name", ""), j.get("type", ""), ends(j)[1], own[0] if own else None, below[name])
        for j, own in found
    ]


def _named(joints: list[_Joint]) -> str:
    names = [f"'{excerpt(j.name, 40)}'" for j in joints]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")


SAME = 1e-6
"""Up to which places and directions are the same, m and 1: rounding of rpy in files is far less for right angles."""


@dataclass(frozen=True)
class WheelPair:
    """A left and a right wheel (joints), by the convention that a robot looks along x; radius and track, m."""

    left: str
    right: str
    radius: float
    track: float


def wheels_of(urdf: Path) -> WheelPair | None:
    """The two wheels of a robot that stands on them: None for any other.

    They are `continuous` joints of one link that turn about one horizontal axis, at mirrored places along it, each with
    a round collision shape. A robot that is welded to a link `world` does not drive.
    """
    robot = reading.read_xml(urdf)
    if any(link.get("name") == "world" for link in robot.findall("link")):
        return None
    radii = {str(link.get("name")): _radius(link) for link in robot.findall("link")}
    turning = [j for j in robot.findall("joint") if j.get("type") == "continuous"]
    pairs = [found for a, b in itertools.combinations(turning, 2) if (found := _pair(a, b, radii)) is not None]
    return pairs[0] if len(pairs) == 1 else None


def _pair(a: ElementTree.Element, b: ElementTree.Element, radii: dict[str, float | None]) -> WheelPair | None:
    (parent, child), (others_parent, others_child) = ends(a), ends(b)
    own, other = radii.get(child), radii.get(others_child)
    if parent != others_parent or own is None or other is None or abs(own - other) > SAME:
        return None
    (place, axis), (there, along) = axle(a), axle(b)
    apart = place - there
    track = abs(float(axis @ apart))
    mirrored = np.abs(apart - (axis @ apart) * axis).max() <= SAME and abs(float(axis @ (place + there))) <= SAME
    if not mirrored or track <= SAME or abs(axis[2]) > SAME or abs(abs(float(axis @ along)) - 1.0) > SAME:
        return None
    left, right = (a, b) if place[1] > there[1] else (b, a)
    return WheelPair(str(left.get("name")), str(right.get("name")), own, track)


def axle(joint: ElementTree.Element) -> tuple[Floats, Floats]:
    """Place (3,) and direction (3,) of a joint's axis, in the frame of its parent."""
    place, turned = placed_at(joint)
    return place, np.asarray(turned.apply(numbers(joint, "axis", "xyz", "1 0 0")))


def _radius(link: ElementTree.Element) -> float | None:
    """Radius of a link's collision shape if it is a cylinder or a sphere."""
    shape = next((shape for kind in _ROUND if (shape := link.find(kind)) is not None), None)
    return None if shape is None else float(shape.get("radius", "nan"))
