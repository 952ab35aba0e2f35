"""Base of a robot, which a URDF does not name: bolted to the world, on wheels or legs, or free.

A URDF has no word for it, and a controller of a quadruped that hangs in the air is right for nothing.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from simgap.errors import excerpt

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
        return Base("free", f"joint '{excerpt(loose.name, 40)}' is {loose.kind}: a base that moves freely")
    trunk, limbs = list[_Joint](), [j for j in joints if j.on is None]
    while len(limbs) == 1:
        trunk += limbs
        limbs = [j for j in joints if j.on == trunk[-1].name]
    slides = [j for j in trunk[:3] if j.kind == "prismatic"]
    if driven is not None and len(slides) > 1 and not {j.name for j in slides} & {*driven}:
        return Base("free", f"nothing drives {_named(slides)}, on which all else hangs: a base that moves freely")
    links = {link.get("name"): link for link in robot.findall("link")}
    ends = [j for j in joints if j.kind == "continuous" and j.below == 1]
    named = [j for j in ends if "wheel" in f"{j.name} {j.child}".lower()]
    wheels = named or [j for j in ends if any(links[j.child].find(shape) is not None for shape in _ROUND)]
    anchored = world and "world" in links and not slides
    if not anchored and (named or len(wheels) > 1):
        return Base("wheels", f"it has wheels ({_named(wheels)})")
    if not anchored and (not trunk or len(slides) > 1) and (len(limbs) > 2 or sum(j.below > 1 for j in limbs) > 1):
        return Base("limbs", f"{len(limbs)} chains of joints begin at its base ({_named(limbs)}), as legs do")
    base, carried = _masses(robot, joints)
    if world and not anchored and base > carried:
        words = f"its base weighs {base:.3g} kg and all that it carries {carried:.3g} kg"
        return Base("free", f"{words}, as of one that moves freely")
    return Base("fixed", "one chain of joints" if not anchored else "it hangs on a link `world`")


def _masses(robot: ElementTree.Element, joints: list[_Joint]) -> tuple[float, float]:
    """Mass of the root with what is fixed to it, and of all that it carries, kg."""
    above = {
        j.find("child").get("link", ""): j.find("parent").get("link", "")  # type: ignore[union-attr]
        for j in robot.findall("joint")
    }
    moved, base, carried = {j.child for j in joints}, 0.0, 0.0
    for link in robot.findall("link"):
        mass, at = link.find("inertial/mass"), link.get("name", "")
        own = float(mass.get("value", "0")) if mass is not None else 0.0
        while at not in moved and at in above:
            at = above[at]
        base, carried = (base, carried + own) if at in moved else (base + own, carried)
    return base, carried


def _moving(robot: ElementTree.Element) -> list[_Joint]:
    """The joints that move, in the order of the file."""
    carried = {j.find("child").get("link", ""): j for j in robot.findall("joint")}  # type: ignore[union-attr]
    found, below = list[tuple[ElementTree.Element, list[str]]](), dict[str, int]()
    for joint in robot.findall("joint"):
        if joint.get("type") == "fixed":
            continue
        above, own = joint, list[str]()
        while (up := carried.get(above.find("parent").get("link", ""))) is not None:  # type: ignore[union-attr]
            own += [up.get("name", "")] if up.get("type") != "fixed" else []
            above = up
        found.append((joint, own))
        for name in (joint.get("name", ""), *own):
            below[name] = below.get(name, 0) + 1
    return [
        _Joint(
            name := j.get("name", ""), j.get("type", ""), j.find("child").get("link", ""),  # type: ignore[union-attr]
            own[0] if own else None, below[name],
        )
        for j, own in found
    ]  # fmt: skip


def _named(joints: list[_Joint]) -> str:
    names = [f"'{excerpt(j.name, 40)}'" for j in joints]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
