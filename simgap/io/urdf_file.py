"""A URDF written anew: with other inertias, and for another folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.model.tree import symmetric

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def with_inertial(source: Path, folder: Path, inertial: Mapping[str, Floats]) -> str:
    """The text of the file with these parameters (10,) of each moving link, of all that is welded to it together.

    Links on fixed joints to them weigh nothing in it. Paths of meshes hold from `folder`.
    """
    robot = reading.read_xml(source)
    ends = [(j.find("parent"), j.find("child"), j.get("type")) for j in robot.findall("joint")]
    fixed = {c.get("link"): p.get("link") for p, c, kind in ends if kind == "fixed" and p is not None and c is not None}
    for link in robot.findall("link"):
        name = carrier = link.get("name", "")
        while carrier in fixed:
            carrier = fixed[carrier] or ""
        if name in inertial:
            write_inertial(link, inertial[name])
        elif carrier in inertial and (own := link.find("inertial")) is not None:
            link.remove(own)
    move_meshes(robot, source.parent, folder)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def write_inertial(link: ElementTree.Element, p: Floats) -> None:
    """Give a link these parameters (10,); none if it weighs nothing."""
    if not p[0] > 0.0:
        return
    m, com = float(p[0]), p[1:4] / p[0]
    about = symmetric(p[4:]) - m * (com @ com * np.eye(3) - np.outer(com, com))
    old = link.find("inertial")
    if old is not None:
        link.remove(old)
    own = ElementTree.Element("inertial")
    link.insert(0, own)
    ElementTree.SubElement(own, "origin", {"xyz": " ".join(f"{c:.9g}" for c in com), "rpy": "0 0 0"})
    ElementTree.SubElement(own, "mass", {"value": f"{m:.9g}"})
    values = about[np.triu_indices(3)]
    ElementTree.SubElement(own, "inertia", {n: repr(float(v)) for n, v in zip(MOMENTS, values, strict=True)})


def move_meshes(robot: ElementTree.Element, source: Path, folder: Path) -> None:
    """Rewrite relative paths of meshes that start from `source` so that they start from `folder`."""
    for mesh in robot.iter("mesh"):
        file = mesh.get("filename", "")
        if file and "://" not in file and not Path(file).is_absolute():
            mesh.set("filename", Path(os.path.relpath(source / file, folder)).as_posix())
