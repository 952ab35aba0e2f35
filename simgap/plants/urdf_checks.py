"""What a URDF must have before two engines may be trusted to read it alike."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from simgap.errors import UserError


def check_urdf(path: Path) -> None:
    """Refuse what engines would silently complete each in its own way.

    A link without `<inertial>` gets mass 1 and inertia 1, 1, 1 in PyBullet and nothing in Drake.

    Raises:
        UserError: missing file, broken XML, or a moving link without mass and inertia.
    """
    if not path.is_file():
        raise UserError("the model file does not exist", file=path, remedy="Correct `plant.urdf`.")
    try:
        robot = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise UserError(f"not well-formed XML: {error}", file=path) from None
    if robot.tag != "robot":
        raise UserError(f"the root element is <{robot.tag}>, not <robot>", file=path)
    moving = {joint.find("child") for joint in robot.findall("joint") if joint.get("type") != "fixed"}
    names = {child.get("link") for child in moving if child is not None}
    for link in robot.findall("link"):
        if link.get("name") in names and not _has_inertia(link):
            raise UserError(
                "a moving link without mass and inertia",
                file=path,
                key=f"link '{link.get('name')}'",
                remedy="Add <inertial> with <mass> and <inertia>; engines invent different ones.",
            )


def _has_inertia(link: ElementTree.Element) -> bool:
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    return mass is not None and inertia is not None and float(mass.get("value", "0")) > 0


def root_link(path: Path) -> str:
    """The link that no joint moves, which a fixed-base plant welds to the world."""
    robot = ElementTree.parse(path).getroot()
    children = {child.get("link") for joint in robot.findall("joint") if (child := joint.find("child")) is not None}
    roots = [str(link.get("name")) for link in robot.findall("link") if link.get("name") not in children]
    if len(roots) != 1:
        raise UserError(f"a model needs one root link, this has {roots}", file=path)
    return roots[0]
