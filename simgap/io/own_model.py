"""The model file that a new case gets of its own where the given one holds more: joints locked, shapes left out.

A locked joint is a fixed one, turned to where it is locked; what is welded together becomes one link, for the equations
of an arm hold the parameters of every link that has any.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.io.inertial_file import write_inertial
from simgap.io.wheeled_urdf import numbers
from simgap.late import scipy
from simgap.model.tree import Tree
from simgap.plants.model_file import FileJoint

_OF_MOTION = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")


def lock(robot: ElementTree.Element, joints: Collection[str], at: Mapping[str, float]) -> None:
    """Make these joints of a URDF fixed ones that stand at `at`, rad or m; and leave out meshes, which enter no motion.

    What mimics another locked joint stands where that puts it.
    """
    for joint in robot.findall("joint"):
        if joint.get("name") in joints:
            _lock(joint, _place(joint, at))
    for link in robot.findall("link"):
        for shape in [s for s in link if s.tag in ("visual", "collision")]:
            link.remove(shape)
    for drive in [d for d in robot.findall("transmission") if {j.get("name") for j in d.findall("joint")} & {*joints}]:
        robot.remove(drive)


def composed(robot: ElementTree.Element, tree: Tree, root: str) -> str:
    """The text of a URDF in which what is welded together is one link.

    Args:
        robot: whose joints have limits, dynamics and drives. tree: its bodies. root: the link that moves nowhere.
    """
    whole = ElementTree.Element("robot", {"name": robot.get("name", "")})
    ElementTree.SubElement(whole, "link", {"name": root})
    old = {joint.get("name"): joint for joint in robot.findall("joint")}
    for k, name in enumerate(tree.joints):
        write_inertial(ElementTree.SubElement(whole, "link", {"name": tree.links[k]}), tree.inertial[k])
        joint = ElementTree.SubElement(whole, "joint", {"name": name, "type": old[name].get("type", "")})
        joint.append(origin_of(tree.place[k], scipy.spatial.transform.Rotation.from_matrix(tree.turn[k])))
        parent = tree.links[tree.parent[k]] if tree.parent[k] >= 0 else root
        ElementTree.SubElement(joint, "parent", {"link": parent})
        ElementTree.SubElement(joint, "child", {"link": tree.links[k]})
        ElementTree.SubElement(joint, "axis", {"xyz": _words(tree.axis[k])})
        joint.extend(part for part in old[name] if part.tag in ("limit", "dynamics", "mimic"))
    drives = robot.findall("transmission")
    whole.extend(d for d in drives if {j.get("name", "") for j in d.findall("joint")} <= {*tree.joints})
    ElementTree.indent(whole)
    return ElementTree.tostring(whole, encoding="unicode", xml_declaration=True) + "\n"


def refuse_coupled(path: Path, joints: Mapping[str, FileJoint], keep: Collection[str]) -> None:
    """A joint that mimics another is no coordinate of its own, and engines let it go its own way.

    Raises:
        UserError: with both joints.
    """
    for name, joint in joints.items():
        if joint.mimics is not None and {name, joint.mimics} & {*keep}:
            free = [n for n, j in joints.items() if j.mimics is None and n not in {o.mimics for o in joints.values()}]
            others = f"simgap new --joints {free[0]} keeps others and locks these" if free else "Take <mimic> out"
            raise UserError(
                f"mimics '{joint.mimics}': the two are one coordinate, and engines let each go its own way",
                file=path, key=f"joint '{name}'", remedy=f"{others}, or write equations.",
            )  # fmt: skip


def _place(joint: ElementTree.Element, at: Mapping[str, float]) -> float:
    mimic = joint.find("mimic")
    if mimic is None:
        return at[joint.get("name", "")]
    ratio, offset = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    return ratio * at.get(mimic.get("joint", ""), 0.0) + offset


def _lock(joint: ElementTree.Element, position: float) -> None:
    origin, axis = joint.find("origin"), numbers(joint.find("axis"), "xyz", "1 0 0")
    place = numbers(origin, "xyz", "0 0 0")
    turned = scipy.spatial.transform.Rotation.from_euler("xyz", numbers(origin, "rpy", "0 0 0"))
    if joint.get("type") == "prismatic":
        place = place + turned.apply(position * axis)
    else:
        turned = turned * scipy.spatial.transform.Rotation.from_rotvec(position * axis)
    for part in [p for p in joint if p.tag in ("origin", *_OF_MOTION)]:
        joint.remove(part)
    joint.set("type", "fixed")
    joint.insert(0, origin_of(place, turned))


def origin_of(place: Floats, turned: scipy.spatial.transform.Rotation) -> ElementTree.Element:
    """<origin> of a place (3,) in m and a rotation."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # upright, roll and yaw turn about one axis: one of them is 0
        angles = turned.as_euler("xyz")
    return ElementTree.Element("origin", {"xyz": _words(place), "rpy": _words(angles)})


def _words(values: Floats) -> str:
    return " ".join(f"{v:.12g}" for v in np.round(values, 12) + 0.0)
