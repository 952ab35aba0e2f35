"""Checks of a URDF, so that two engines read it alike, and of the units of the joints of a case."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.named_files import places_of
from simgap.config.plant import PlantSection
from simgap.errors import SimgapError, UserError, excerpt
from simgap.units import require_unit

NUMBERS: Mapping[str, Mapping[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
}
"""Attributes that hold numbers: by element, how many numbers each."""
NOT_NEGATIVE = {
    ("mass", "value"), ("dynamics", "damping"), ("dynamics", "friction"), ("limit", "effort"), ("limit", "velocity"),
}  # fmt: skip
POSITIVE = {("box", "size"), ("sphere", "radius"), ("cylinder", "radius"), ("cylinder", "length")}
TRUST = "SIMGAP_TRUST_MODEL_FILES"
"""Environment variable: 1 where models may name files anywhere."""
_NAMED = {"link", "joint"}
_CLOSING = ("drake:ball_constraint", "drake:linear_bushing_rpy", "drake:joint", "loop_joint")
_FORMATS = {
    "mujoco": "It is MJCF: simgap new NAME --mjcf FILE, and in a case simulator.mjcf.",
    "sdf": "It is SDF: convert it to a URDF.",
}
_UNIT = 1e-3  # from length 1, of an axis that is rounded to three decimals
_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""Excess of a moment of inertia that Drake takes for rounding, kg m^2, or of the largest if that is more (measured)."""


def check_urdf(path: Path) -> None:
    """Refuse what engines would silently complete or correct each in its own way.

    Shapes, axes of joints that do not move and tags that nobody knows enter no motion, and are not looked at.

    Raises:
        UserError: what `check_structure` or `check_bodies` refuses, or files beyond the folders of the model.
    """
    check_structure(path)
    for part in _root(path):
        for element in part.iter():
            _check_place(path, part, element)
    check_bodies(path)


def check_structure(path: Path) -> None:
    """Refuse a file that is no tree of links and joints with numbers.

    Raises:
        UserError: missing file, broken XML, another format, names that are missing or not there, numbers that are none,
            closed chains; with file, link or joint, attribute.
    """
    robot = _root(path)
    parts = [part for part in robot if part.tag in _NAMED]
    for part in parts:
        if not (part.get("name") or "").strip():
            _refuse(path, part, "name", "is missing or empty", "Name every link and joint.")
        for element in _felt(part):
            _check_numbers(path, part, element)
    for tag in _CLOSING:
        if robot.find(tag) is not None:
            raise UserError(f"<{tag}> closes a chain, which not all engines do", file=path, remedy="Take it out.")
    links = _by_name(path, robot.findall("link"))
    joints = _by_name(path, robot.findall("joint"))
    for joint in joints.values():
        for end in ("parent", "child"):
            named = attributes(joint, end).get("link")
            if named not in links:
                world = 'Add <link name="world"/>, which only Drake assumes.'
                remedy = world if named == "world" else "Correct it."
                _refuse(path, joint, f"<{end}> link", "names no link of this file", remedy)
        _check_range(path, joint)
    _check_tree(path, joints)


def check_bodies(path: Path, locked: Collection[str] = (), floating: bool = False) -> None:
    """Refuse bodies with which engines would compute each in its own way, of a file that `check_structure` has taken.

    A link without `<inertial>` gets mass 1 and inertia 1, 1, 1 in PyBullet and nothing in Drake. In place of moments
    that no body has PyBullet takes 0 and Drake those of a small sphere, both in silence, and MuJoCo refuses the file.

    Args:
        locked: joints that the case holds still. floating: whether the root moves, and all that is fixed to it.

    Raises:
        UserError: a moving link without mass and inertia, or an inertia that no body has.
    """
    robot = _root(path)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    joints = [j for j in robot.findall("joint") if j.get("type") != "fixed" and j.get("name") not in locked]
    moving = {ends(joint)[1] for joint in joints}
    bare = [name for name in links if name in moving and _massless(links[name])]
    if bare:
        raise UserError(
            f"moving link{'s' * (len(bare) > 1)} without mass and inertia", file=path,
            key=f"link {', '.join(repr(excerpt(name, 40)) for name in bare[:4])}{' ...' * (len(bare) > 4)}",
            remedy="Add <inertial> with <mass> and <inertia>; engines invent different ones.",
        )  # fmt: skip
    for name in links if floating else links_moved(robot, locked):
        _check_inertia(path, links[name])


def links_moved(robot: ElementTree.Element, locked: Collection[str] = ()) -> list[str]:
    """Links that some joint moves, by itself or through others; `locked` joints move nothing themselves."""
    moved: list[str] = []
    pairs = [(j.get("type") == "fixed" or j.get("name") in locked, *ends(j)) for j in robot.findall("joint")]
    while more := [c for held, p, c in pairs if (not held or p in moved) and c not in moved]:
        moved += more
    return moved


def attributes(part: ElementTree.Element, path: str) -> Mapping[str, str]:
    """The attributes of an element below a link or joint; none where it is not there."""
    found = part.find(path)
    return {} if found is None else found.attrib


def ends(joint: ElementTree.Element) -> tuple[str, str]:
    """The links that a joint joins: parent and child."""
    return attributes(joint, "parent").get("link", ""), attributes(joint, "child").get("link", "")


def mass_of(link: ElementTree.Element) -> float:
    """Mass that a link states, kg; 0 for none."""
    return float(attributes(link, "inertial/mass").get("value", "0"))


@contextmanager
def loading(engine: str, path: Path) -> Iterator[None]:
    """Around every load of a model file: what an engine has against it is a mistake in the file, told in one line.

    Raises:
        UserError: whatever the engine raises, with the file and what the engine says of it.
    """
    try:
        yield
    except SimgapError:
        raise
    except Exception as error:
        message = excerpt(str(error) or type(error).__name__, 300)
        absent = [n for n in _meshes(path) if "://" not in n and not reading.is_file(path.parent / n)]
        lacks = f"; there is no {excerpt(absent[0], 80)}" if absent and absent[0] not in message else ""
        gone = lacks or "opening file" in message
        raise UserError(
            f"{engine} does not take it: {message.rstrip('.')}{lacks}", file=path,
            remedy="Put what is missing beside it, or take out what names it." if gone else "Correct it.",
        ) from None  # fmt: skip


def _meshes(path: Path) -> list[str]:
    try:
        return [str(mesh.get("filename") or mesh.get("file") or "") for mesh in reading.read_xml(path).iter("mesh")]
    except (UserError, ElementTree.ParseError, LookupError, OSError, ValueError):
        return []


def _check_tree(path: Path, joints: Mapping[str, ElementTree.Element]) -> None:
    """A link hangs on one joint: on two it closes a chain, which a URDF cannot say and engines read each its way.

    Links that carry each other close one beside the root, on which nothing then hangs them.
    """
    above: dict[str, ElementTree.Element] = {}
    for joint in joints.values():
        child = ends(joint)[1]
        if child in above:
            both = " and ".join(f"'{excerpt(j.get('name', ''), 40)}'" for j in (above[child], joint))
            why = f"joints {both} both carry it: a closed chain"
            _refuse(path, joint, f"<child> link '{excerpt(child, 40)}'", why, "Open the chain at one of them.")
        above[child] = joint
    for child, joint in above.items():
        link, ring = ends(joint)[0], {child}
        while link in above and link not in ring:
            ring.add(link)
            link = ends(above[link])[0]
        if link == child:
            named = ", ".join(f"'{excerpt(n, 40)}'" for n in sorted(ring)[:4])
            why = f"its chain leads back to it: {named} hang on each other and not on a root"
            _refuse(path, joint, f"<child> link '{excerpt(child, 40)}'", why, "Attach one of them to the root.")


def _root(path: Path) -> ElementTree.Element:
    if not reading.is_file(path):
        remedy = "Correct its path (`plant.urdf` of a case, `--urdf` of `simgap new`)."
        raise UserError("the model file does not exist", file=path, remedy=remedy)
    robot = reading.read_xml(path)
    if robot.tag != "robot":
        problem = f"the root element is <{excerpt(robot.tag, 40)}>, not <robot>"
        raise UserError(problem, file=path, remedy=_FORMATS.get(robot.tag, "A URDF begins with <robot>."))
    for element in robot.iter():
        filled = next((v for v in element.attrib.values() if "${" in v or "$(" in v), None)
        if element.tag.startswith("xacro:") or filled is not None:
            why = f"<{excerpt(element.tag, 40)}>" if filled is None else f"'{excerpt(filled, 60)}'"
            raise UserError(
                f"a xacro template, not a URDF: it holds {why}", file=path,
                remedy="Run xacro first: xacro FILE > robot.urdf.",
            )  # fmt: skip
    return robot


def _felt(part: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Parts of a link or joint that may enter a motion: not what is only drawn, nor the axis of a fixed joint."""
    yield part
    for child in part:
        if child.tag != "visual" and (child.tag != "axis" or part.get("type") != "fixed"):
            yield from child.iter()


def _check_range(path: Path, joint: ElementTree.Element) -> None:
    """Limits in the wrong order end Drake's process, and are none for PyBullet."""
    lower, upper = (attributes(joint, "limit").get(end, "0") for end in ("lower", "upper"))
    if joint.get("type") in ("revolute", "prismatic") and float(lower) > float(upper):
        remedy = "Correct them; a hinge without limits is `continuous`."
        _refuse(path, joint, "<limit> lower, upper", f"'{lower}' lies above '{upper}'", remedy)


def _refuse(path: Path, part: ElementTree.Element, what: str, problem: str, remedy: str) -> NoReturn:
    key = f"{part.tag} '{excerpt(part.get('name', ''), 40)}': {what}"
    raise UserError(problem, file=path, key=key, remedy=remedy)


def _by_name(path: Path, parts: list[ElementTree.Element]) -> dict[str, ElementTree.Element]:
    named: dict[str, ElementTree.Element] = {}
    for part in parts:
        name = part.get("name", "")
        if name in named:
            _refuse(path, part, "name", "appears twice", "Rename one of them.")
        named[name] = part
    return named


def _check_numbers(path: Path, part: ElementTree.Element, element: ElementTree.Element) -> None:
    for attribute, count in NUMBERS.get(element.tag, {}).items():
        text = element.get(attribute)
        if text is None:
            continue
        what = f"<{element.tag}> {attribute}"
        values = [number_of(word) for word in text.split()] if len(text) < 1000 else []
        if len(values) != count or not all(math.isfinite(v) for v in values):
            wanted = "one number" if count == 1 else f"{count} numbers"
            _refuse(path, part, what, f"'{excerpt(text, 60)}' is not {wanted}", "Correct it.")
        least = min(values)
        if (element.tag, attribute) in NOT_NEGATIVE and least < 0:
            _refuse(path, part, what, f"'{text}' is negative", "Correct it.")
        if (element.tag, attribute) in POSITIVE and least <= 0:
            _refuse(path, part, what, f"'{text}' is not positive", "Correct it.")
        if element.tag == "axis" and not any(values):
            _refuse(path, part, what, f"'{text}' has no direction", "Correct it.")
        if element.tag == "axis" and abs(math.hypot(*values) - 1.0) > _UNIT:
            why = f"'{text}' has length {math.hypot(*values):.6g}; PyBullet takes the length into the dynamics"
            _refuse(path, part, what, why, "Scale it to length 1.")


def _check_place(path: Path, part: ElementTree.Element, element: ElementTree.Element) -> None:
    """Files that a model names, such as meshes, lie below the folder above its own, where packages keep them.

    A model may come from a stranger, and engines open whatever it names. Only who runs simgap can allow more, not the
    case: by the environment variable `TRUST`.
    """
    name = element.get("filename")
    if name is not None and not inside_folders(path, name):
        why = f"'{excerpt(name, 60)}' lies outside the model's folders"
        remedy = f"Put it beside the model, or trust it: set {TRUST}=1."
        _refuse(path, part, f"<{excerpt(element.tag, 40)}> filename", why, remedy)


def inside_folders(path: Path, name: str) -> bool:
    """True if a file that a model names lies where packages keep theirs, or whoever runs simgap trusts the model."""
    scheme = name.rpartition("://")[0]
    places = places_of(path if scheme == "package" else reading.real(path), name)[:1]
    known = scheme in ("", "package", "file") or os.environ.get(TRUST) == "1"
    return known and all(inside(path, place) for place in places)


def inside(path: Path, place: Path) -> bool:
    """The same of a file at its place."""
    folder = reading.real(Path(os.path.abspath(path)).parent.parent)
    return os.environ.get(TRUST) == "1" or reading.real(place).is_relative_to(folder)


def number_of(word: str) -> float:
    """A number as engines read it, or NaN: digits of other scripts and underscores are none."""
    try:
        return float(word) if word.isascii() and "_" not in word else math.nan
    except ValueError:
        return math.nan


def _massless(link: ElementTree.Element) -> bool:
    return mass_of(link) == 0.0 or link.find("inertial/inertia") is None


def _check_inertia(path: Path, link: ElementTree.Element) -> None:
    """Refuse moments that no body has: the largest is at most the sum of the others, and so none is negative."""
    least, middle, most = moments = principal_moments(link)
    excess = most - middle - least
    if excess > _ROUNDING * max(1.0, most):
        why = (
            f"no body has principal moments of {', '.join(f'{v:.4g}' for v in moments)} kg m^2, the largest exceeds "
            f"the sum of the others by {excess:.2g}; Drake would take a sphere's, PyBullet 0, and MuJoCo refuses"
        )
        _refuse(path, link, "<inertia>", why, "Correct it, for instance to that of a uniform body of its shape.")


def principal_moments(link: ElementTree.Element) -> Floats:
    """Principal moments of a link's `<inertia>`, kg m^2, ascending (3,); zeros for none."""
    stated = attributes(link, "inertial/inertia")
    ixx, iyy, izz, ixy, ixz, iyz = (float(stated.get(name, "0")) for name in NUMBERS["inertia"])
    return np.asarray(np.linalg.eigvalsh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])))


def root_link(path: Path) -> str:
    """The link that no joint moves, which a fixed-base plant welds to the world."""
    robot = _root(path)
    children = {ends(joint)[1] for joint in robot.findall("joint")}
    roots = [str(link.get("name")) for link in robot.findall("link") if link.get("name") not in children]
    if len(roots) != 1:
        raise UserError(f"a model needs one root link, this has {excerpt(roots)}", file=path)
    return roots[0]


def check_wheels(path: Path, left: str, right: str) -> None:
    """Refuse wheels that are no joints, do not turn without end, or are one joint twice: an engine says nothing.

    Raises:
        UserError: with the key of the simulator, and what the file has.
    """
    types = {j.get("name", ""): j.get("type", "") for j in _root(path).findall("joint")}
    turning = [name for name, kind in types.items() if kind == "continuous"]
    remedy = f"Joints of {path.name} that turn without end: {', '.join(turning) or 'none'}."
    for key, name in (("simulator.left", left), ("simulator.right", right)):
        if name not in types:
            raise UserError(f"no joint called '{name}' in {path.name}", key=key, remedy=remedy)
        if name not in turning:
            raise UserError(f"the joint '{name}' is {types[name]}, not a wheel's (continuous)", key=key, remedy=remedy)
    if left == right:
        raise UserError(f"'{left}' is both wheels", key="simulator.right", remedy=remedy)


def check_floating_root(path: Path) -> None:
    """Refuse a root without mass and inertia in a robot that stands freely, as `base_footprint` often is.

    PyBullet gives such a root 1 kg and 1, 1, 1 kg m^2, or holds it still if it has mass 0; a root that is welded to
    the world is asked for neither.

    Args:
        path: a file that `check_urdf` has taken.

    Raises:
        UserError: such a root, or an inertia of the root or of what is fixed to it that no body has.
    """
    check_bodies(path, floating=True)
    name = root_link(path)
    link = next(part for part in _root(path).findall("link") if part.get("name") == name)
    inertia = attributes(link, "inertial/inertia")
    if _massless(link) or not any(float(inertia.get(k, "0")) for k in ("ixx", "iyy", "izz")):
        _refuse(
            path, link, "<inertial>", "the root of a free-standing robot has no mass and inertia",
            "Make the chassis the root, its frame midway between the wheels, or give this link its mass and inertia.",
        )  # fmt: skip


_TURNS = {"position": "rad", "velocity": "rad/s", "force": "N*m"}
_SLIDES = {"position": "m", "velocity": "m/s", "force": "N"}


def check_joint_units(section: PlantSection, urdf: Path) -> None:
    """Refuse states and inputs that stand for no moving joint of the file, or in a unit other than the joint's.

    Their numbers go to the engine as they are: a state in deg would be labelled deg and hold radians.

    Raises:
        UserError: naming the key and the joints there are, or the unit that is wanted.
    """
    robot = reading.read_xml(urdf)
    if robot.tag != "robot":
        return
    check_units(section, {str(j.get("name")): str(j.get("type")) for j in robot.findall("joint")}, urdf.name)


def check_units(section: PlantSection, types: Mapping[str, str], file: str) -> None:
    """The same for the joints of any model file, by name: prismatic, fixed, or one that turns.

    Raises:
        UserError: as `check_joint_units`.
    """
    for group, owners in (("states", section.states), ("inputs", section.inputs)):
        for name, owner in owners.items():
            if owner.joint is None:
                continue
            kind = types.get(owner.joint, "fixed")
            if kind == "fixed":
                moving = ", ".join(n for n, other in types.items() if other != "fixed") or "none"
                problem = f"{file} has no moving joint '{owner.joint}'"
                raise UserError(problem, key=f"plant.{group}.{name}.joint", remedy=f"Moving joints: {moving}.")
            wanted = (_SLIDES if kind == "prismatic" else _TURNS).get(getattr(owner, "quantity", "force"))
            if wanted is not None:
                require_unit(owner.unit, wanted, f"plant.{group}.{name}.unit")
