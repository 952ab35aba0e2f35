"""The model file of a new case: the given one, or one beside the case with joints locked.

A locked joint is a fixed one, turned to where it is locked; what is welded together becomes one link, for the equations
of an arm hold the parameters of every link that has any.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.named_files import places_of
from simgap.errors import UserError, excerpt
from simgap.io.atomic import write_text
from simgap.io.urdf_file import write_inertial
from simgap.late import scipy
from simgap.model.tree import Tree
from simgap.plants.model_file import Base, FileJoint, ModelFile, base_of, numbers, placed_at, read_model_file
from simgap.plants.urdf import load_tree
from simgap.plants.urdf_checks import check_bodies, check_structure, check_urdf, inside_folders, root_link

_OF_MOTION = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")


SPEED, TAU = 0.5, 0.01
"""Half-width of X for a velocity, rad/s or m/s, and sampling time, s. Judgement: for a first run of a minute."""


def named_joints(names: Collection[str], joints: Collection[str], key: str) -> tuple[str, ...]:
    """The moving joints of these names, in the order of the file.

    Raises:
        UserError: no name, or one that is no moving joint's.
    """
    unknown = [n for n in names if n not in joints]
    if unknown or not names:
        raise UserError(
            f"there is no moving joint {', '.join(map(repr, unknown))}" if unknown else "no joint is named",
            key=key, remedy=f"Moving joints: {', '.join(joints)}.",
        )  # fmt: skip
    return tuple(n for n in joints if n in names)


def check_positions(joints: Mapping[str, FileJoint], at: Mapping[str, float]) -> None:
    """Refuse a name that is no moving joint's, and a position that the joint does not reach.

    Raises:
        UserError: either.
    """
    if at:
        named_joints(at, joints, "--at")
    for name, position in at.items():
        lower, upper = joints[name].range or (-math.inf, math.inf)
        if not lower <= position <= upper:
            raise UserError(
                f"{name}={position:g} is beyond a stop: the joint goes from {lower:g} to {upper:g}", key="--at",
                remedy="Give a posture within its limits, or correct <limit> in the URDF.",
            )  # fmt: skip


def centre_of(joint: FileJoint) -> float:
    """Position at which a joint is looked at unless given: 0, or the middle of a range that has no room about 0."""
    if joint.range is None or joint.range[0] + SPEED * TAU < 0.0 < joint.range[1] - SPEED * TAU:
        return 0.0
    return 0.5 * (joint.range[0] + joint.range[1])


def lock(robot: ElementTree.Element, joints: Collection[str], at: Mapping[str, float]) -> None:
    """Make these joints of a URDF fixed ones that stand at `at`, rad or m; and leave out meshes, which enter no motion.

    What mimics another locked joint stands where that puts it.
    """
    for joint in robot.findall("joint"):
        if joint.get("name") in joints or joint.get("type") == "fixed":
            _lock(joint, _place(joint, at))
    for link in robot.findall("link"):
        for shape in [s for s in link if s.tag in ("visual", "collision")]:
            link.remove(shape)
    moving = {joint.get("name") for joint in robot.findall("joint") if joint.get("type") != "fixed"}
    for drive in [d for d in robot.findall("transmission") if {j.get("name") for j in d.findall("joint")} - moving]:
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
        ElementTree.SubElement(joint, "axis", {"xyz": written(tree.axis[k])})
        joint.extend(part for part in old[name] if part.tag in ("limit", "dynamics", "mimic"))
    drives = robot.findall("transmission")
    whole.extend(d for d in drives if {j.get("name", "") for j in d.findall("joint")} <= {*tree.joints})
    ElementTree.indent(whole)
    return ElementTree.tostring(whole, encoding="unicode", xml_declaration=True) + "\n"


def origin_of(place: Floats, turned: scipy.spatial.transform.Rotation) -> ElementTree.Element:
    """<origin> of a place (3,) in m and a rotation."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # upright, roll and yaw turn about one axis: one of them is 0
        angles = turned.as_euler("xyz")
    return ElementTree.Element("origin", {"xyz": written(place), "rpy": written(angles)})


def written(values: Floats) -> str:
    """Numbers as an attribute of a URDF has them."""
    return " ".join(f"{v:.12g}" for v in np.round(values, 12) + 0.0)


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
                f"mimics '{joint.mimics}': the two are one coordinate, but engines move them independently",
                file=path, key=f"joint '{name}'", remedy=f"{others}, or write equations.",
            )  # fmt: skip


def _place(joint: ElementTree.Element, at: Mapping[str, float]) -> float:
    mimic = joint.find("mimic")
    if joint.get("type") == "fixed":
        return 0.0
    if mimic is None:
        return at[joint.get("name", "")]
    ratio, offset = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    return ratio * at.get(mimic.get("joint", ""), 0.0) + offset


def _lock(joint: ElementTree.Element, position: float) -> None:
    (place, turned), axis = placed_at(joint), numbers(joint, "axis", "xyz", "1 0 0")
    if joint.get("type") == "prismatic":
        place = place + turned.apply(position * axis)
    else:
        turned = turned * scipy.spatial.transform.Rotation.from_rotvec(position * axis)
    for part in [p for p in joint if p.tag in ("origin", *_OF_MOTION)]:
        joint.remove(part)
    joint.set("type", "fixed")
    joint.insert(0, origin_of(place, turned))


BASES = ("fixed", "wheels")
_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class Asked:
    """Wishes of a person for a robot: joints to keep, all if None; positions; what its base is; where its case goes."""

    joints: Sequence[str] | None
    at: Mapping[str, float]
    base: str | None
    place: Path
    """NAME of the case, in its folder."""
    inputs: Sequence[str] | None = None
    """Joints that have a drive; those that the file says if None."""
    until: float = math.inf
    """CPU time of this process, s, at which a search ends."""
    tell: Callable[[str], None] = lambda words: None
    note: Callable[[str], None] = lambda words: None
    made: list[Path] = field(default_factory=list)
    """Files beside the case, written or about to be: they go where it does not come to be."""

    def beside(self, ending: str) -> Path:
        """A file of the case's own, which joins `made`.

        Raises:
            UserError: it is there already.
        """
        path = self.place.with_name(f"{self.place.name}_model{ending}")
        if path.exists():
            raise UserError("already exists and is left unchanged", file=path, remedy="Give another name, or move it.")
        self.made.append(path)
        return path


@dataclass(frozen=True, eq=False)
class NewModel:
    """A model file ready for a case.

    Attributes:
        mjcf: the simulator's own file. effects: of the plant: (name, joint, parameters). gravity: m/s^2.
        step: of the simulator, s; None for its usual one.
    """

    file: ModelFile
    mjcf: Path | None = None
    effects: tuple[tuple[str, str, Mapping[str, float]], ...] = ()
    gravity: float = 9.81
    step: float | None = None


def model_of_urdf(path: Path, asked: Asked) -> NewModel:
    """The file itself, or a copy in which joints are locked, and meshes that nothing finds are left out.

    Raises:
        UserError: a file that cannot be taken, a base of which it says nothing, coupled joints, names or positions that
            are none of its joints'.
    """
    file, robot = read_model_file(path, check_structure), reading.read_xml(path)
    check_positions(file.joints, asked.at)
    keep = _kept(path, file.joints, asked)
    check_base(path, base_of(robot, file.driven), asked.base)
    refuse_coupled(path, file.joints, keep)
    locked = [n for n in file.joints if n not in keep]
    check_bodies(path, locked)  # of what the case has: of what is welded together engines see the whole
    absent = [
        m for m in file.meshes if not inside_folders(path, m) or not any(map(reading.is_file, places_of(path, m)[:1]))
    ]
    if not locked and not absent:
        return NewModel(file)
    places = {n: asked.at.get(n, centre_of(joint)) for n, joint in file.joints.items()}
    made = asked.beside(".urdf")
    lock(robot, locked, places)
    if locked:
        asked.note(f"{made.name} has the other joints locked: {', '.join(f'{n} at {places[n]:.4g}' for n in locked)}.")
    else:
        asked.note(
            f"{made.name} has no shapes: {excerpt(absent[0], 60)} is missing, and shapes do not enter the motion."
        )
    return NewModel(write_model(made, robot))


def write_model(made: Path, robot: ElementTree.Element) -> ModelFile:
    """The robot in a URDF of its own; Drake composes what is welded together.

    Raises:
        UserError: one that Drake does not take.
    """
    write_text(made, ElementTree.tostring(robot, encoding="unicode"))
    write_text(made, composed(robot, load_tree(made), root_link(made)))
    check_urdf(made)
    return read_model_file(made)


def check_base(path: Path, standing: Base, base: str | None) -> None:
    """Refuse a file of which neither it nor a person says what its base is."""
    if base == "wheels":
        raise UserError(
            "no two driven wheels are seen: `continuous` joints of one link about one horizontal axis, at mirrored "
            "places, each with a round collision shape", file=path, key="--base", remedy="Write equations for others.",
        )  # fmt: skip
    if standing.kind != "fixed" and base is None:
        raise UserError(
            f"{standing.words}, and the file does not say whether its base is fixed", file=path, key="--base",
            remedy="--base fixed bolts it to the world, as on a stand; for a base that moves, write equations "
            "(simgap new NAME --equations).",
        )  # fmt: skip


def _kept(path: Path, joints: Mapping[str, FileJoint], asked: Asked) -> tuple[str, ...]:
    if asked.joints is not None:
        return named_joints(asked.joints, joints, "--joints")
    kept = tuple(n for n, joint in joints.items() if asked.base != "fixed" or joint.kind in _MOVING)
    if not kept:
        others = ", ".join(dict.fromkeys(joint.kind for joint in joints.values()))
        raise UserError(
            f"has no joint that turns or slides{f', but: {others}' if others else ''}", file=path,
            remedy="Give the model of a robot that moves.",
        )  # fmt: skip
    return kept
