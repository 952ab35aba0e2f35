"""A robot on two driven wheels, recognised in its URDF: its joints' angles are not what a person would design on."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.io.pages import text
from simgap.late import scipy

SAME = 1e-6
"""Up to which places and directions are the same, m and 1: rounding of rpy in files is far less for right angles."""

SPEEDS_UP, LIGHTEST, BEYOND = 1.4, 0.1, 0.05
"""Acceleration that two wheels give the robot, m/s^2 (that of the Pioneer of configs/cases), the mass of one whose file
states none, kg, and what is beyond its wheels, m. Judgement."""


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


def case_of_wheels(name: str, urdf: Path, written: str, wheels: WheelPair) -> str:
    """A case for that robot: its wheels as the file says, a floor with one obstacle, commands of a slow robot.

    Args:
        written: the path of the file as the case has it.
    """
    robot = reading.read_xml(urdf)
    mass = sum(float(m.get("value", "0")) for m in robot.iterfind("link/inertial/mass"))
    limits = [j.find("limit") for j in robot.findall("joint") if j.get("name") in (wheels.left, wheels.right)]
    efforts = [float(own.get("effort", "0")) for own in limits if own is not None]
    wanted = 0.5 * SPEEDS_UP * max(mass, LIGHTEST) * wheels.radius
    torque = min([wanted, *(e for e in efforts if e > 0)])
    return text(
        "new_wheels.yaml.j2", name=name, urdf=written, left=wheels.left, right=wheels.right,
        radius=f"{wheels.radius:.6g}", track=f"{wheels.track:.6g}", mass=f"{mass:.3g}", torque=f"{torque:.2g}",
        limited=torque < wanted, clearance=f"{0.5 * wheels.track + wheels.radius + BEYOND:.2g}",
    )  # fmt: skip


def _pair(a: ElementTree.Element, b: ElementTree.Element, radii: dict[str, float | None]) -> WheelPair | None:
    if _link(a, "parent") != _link(b, "parent"):
        return None
    own, other = radii.get(_link(a, "child")), radii.get(_link(b, "child"))
    if own is None or other is None or abs(own - other) > SAME:
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
    origin, axis = joint.find("origin"), joint.find("axis")
    place = numbers(origin, "xyz", "0 0 0")
    turned = scipy.spatial.transform.Rotation.from_euler("xyz", numbers(origin, "rpy", "0 0 0"))
    return place, np.asarray(turned.apply(numbers(axis, "xyz", "1 0 0")))


def numbers(element: ElementTree.Element | None, key: str, default: str) -> Floats:
    """An attribute of several numbers, or what stands for it."""
    text = default if element is None else element.get(key, default)
    return np.array([float(v) for v in text.split()])


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _radius(link: ElementTree.Element) -> float | None:
    """Radius of a link's collision shape if it is a cylinder or a sphere."""
    for kind in ("cylinder", "sphere"):
        shape = link.find(f"collision/geometry/{kind}")
        if shape is not None:
            return float(shape.get("radius", "nan"))
    return None
