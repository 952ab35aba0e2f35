"""A robot on two driven wheels, recognised in its URDF: its joints' angles are not what a person would design on."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.errors import UserError
from simgap.geometry import Floats

SAME = 1e-6
"""Up to which places and directions are the same, m and 1: rounding of rpy in files is far less for right angles."""


@dataclass(frozen=True)
class Wheels:
    """A left and a right wheel (joints), by the convention that a robot looks along x; radius and track, m."""

    left: str
    right: str
    radius: float
    track: float


def wheels_of(urdf: Path) -> Wheels | None:
    """The two wheels of a robot that stands on them: None for any other.

    They are `continuous` joints of one link that turn about one horizontal axis, at mirrored places along it, each with
    a round collision shape. A robot that is welded to a link `world` does not drive.
    """
    robot = ElementTree.parse(urdf).getroot()
    if any(link.get("name") == "world" for link in robot.findall("link")):
        return None
    radii = {str(link.get("name")): _radius(link) for link in robot.findall("link")}
    turning = [j for j in robot.findall("joint") if j.get("type") == "continuous"]
    pairs = [found for a, b in itertools.combinations(turning, 2) if (found := _pair(a, b, radii)) is not None]
    return pairs[0] if len(pairs) == 1 else None


def refuse_wheels(urdf: Path) -> None:
    """Say how a robot on two wheels becomes a case.

    Raises:
        UserError: the file is one.
    """
    wheels = wheels_of(urdf)
    if wheels is None:
        return
    raise UserError(
        f"is a robot on two driven wheels ('{wheels.left}' and '{wheels.right}'); its joints' angles do not say where "
        "it stands",
        file=urdf,
        remedy="Begin with configs/cases/pioneer.yaml (docs/pioneer.md): states x, y, theta and inputs v, w; in "
        f"`simulator` engine: pybullet_wheeled, urdf, left: {wheels.left}, right: {wheels.right}, wheel_radius: "
        f"{wheels.radius:.6g}, track: {wheels.track:.6g} (also in plant.symbolic.wheels), torque, floor_friction. With "
        "--inputs the wheels are taken as joints.",
    )


def _pair(a: ElementTree.Element, b: ElementTree.Element, radii: dict[str, float | None]) -> Wheels | None:
    if _link(a, "parent") != _link(b, "parent"):
        return None
    own, other = radii.get(_link(a, "child")), radii.get(_link(b, "child"))
    if own is None or other is None or abs(own - other) > SAME:
        return None
    (place, axis), (there, along) = _axle(a), _axle(b)
    apart = place - there
    track = abs(float(axis @ apart))
    mirrored = np.abs(apart - (axis @ apart) * axis).max() <= SAME and abs(float(axis @ (place + there))) <= SAME
    if not mirrored or track <= SAME or abs(axis[2]) > SAME or abs(abs(float(axis @ along)) - 1.0) > SAME:
        return None
    left, right = (a, b) if place[1] > there[1] else (b, a)
    return Wheels(str(left.get("name")), str(right.get("name")), own, track)


def _axle(joint: ElementTree.Element) -> tuple[Floats, Floats]:
    """Place (3,) and direction (3,) of a joint's axis, in the frame of its parent."""
    origin, axis = joint.find("origin"), joint.find("axis")
    place = _numbers(origin, "xyz", "0 0 0")
    turned = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0"))
    return place, np.asarray(turned.apply(_numbers(axis, "xyz", "1 0 0")))


def _numbers(element: ElementTree.Element | None, key: str, default: str) -> Floats:
    text = default if element is None else element.get(key, default)
    return np.array([float(v) for v in text.split()])


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _radius(link: ElementTree.Element) -> float | None:
    """Of a link's collision shape if it is a cylinder or a sphere."""
    for kind in ("cylinder", "sphere"):
        shape = link.find(f"collision/geometry/{kind}")
        if shape is not None:
            return float(shape.get("radius", "nan"))
    return None
