"""A URDF, loaded by Drake: as a symbolic model whose inertial parameters stay symbols, or as a `Tree` of numbers.

Accelerations are `vdot = M^-1 (tau_g - C v - D v + B u)`. Mass matrix, bias and gravity are inverse dynamics of
`model.tree` on symbols in place of numbers: it goes from frame to frame of the bodies, so neither where the base stands
nor how the first joint turns enters M and C v, and expanded a large arm of two joints has some hundred operations.
`drake_check` compares them with Drake's numeric plant. A joint's URDF `friction` is ignored by Drake and therefore
here; `damping` is kept.

Simplifying the equations takes seconds, and every stage of a case builds its model. What comes out is kept in the cache
folder, under a digest of what went in and of SymPy's version; it is written as a tree of names and numbers, so that
nothing of it is ever run. Only what reads back as the same expression is kept.

Writing out the inverse mass matrix of three joints takes a minute of CPU and of six does not end; Newton-Euler on the
numbers takes microseconds (`model.tree`: 17 us a sample with the regressor of six joints). So from three joints on,
W = M^-1 and h (bias and gravity) are undefined functions of what they depend on. Effects act on such equations as on
any: forces, inputs and changed parameters go to their places. What needs the equations themselves (a bound, a
controller) refuses them.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.cache import recall, remember
from simgap.config.plant import Input, State
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol
from simgap.model.tree import PARAMETERS, Tree, forces, moved
from simgap.plants.urdf_checks import loading, root_link

GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
_AXES = "xyz"
_MOMENTS = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_INERTIAL = {
    "m": ("kg", "mass of {}"),
    **{f"c{axis}": ("m", "centre of mass of {} from its joint") for axis in _AXES},
    **dict.fromkeys(_MOMENTS, ("kg*m^2", "inertia of {} about its joint")),
}
"""Inertial parameters of a body: unit, and what it is."""


def load_urdf(
    path: Path, states: Mapping[str, State], inputs: Mapping[str, Input], gravity: float = 9.81
) -> SymbolicModel:
    """Read a URDF into `xdot = F(x, u; p)`.

    Args:
        path: the URDF, which `urdf_checks` has taken; its root link is welded to the world.
        states: by name; every moving joint needs a position and a velocity.
        inputs: by name; an input is the generalised force on its joint.
        gravity: acceleration along -z, m/s^2.

    Raises:
        UserError: a file that Drake does not take, joints and states that do not match.
    """
    own = mechanism(path)
    joints = [joint["name"] for joint in own["joints"]]
    order, rates = _match(path, states, joints)
    parameters = _inertial_parameters(own)
    for name, value in zip(GRAVITY, (0.0, 0.0, -gravity), strict=True):
        parameters[name] = Parameter(value, "m/s^2", "component of gravity in the world frame")
    units = ["N" if joint["slides"] else "N*m" for joint in own["joints"]]
    forces = []
    for joint, rate, force, damping in zip(joints, rates, units, (j["damping"] for j in own["joints"]), strict=True):
        drive = sum((symbol(n) for n, i in inputs.items() if i.joint == joint), sp.Integer(0))
        if damping:
            unit = "N*m*s/rad" if force == "N*m" else "N*s/m"
            parameters[f"{joint}.damping"] = Parameter(damping, unit, "viscous damping declared in the URDF")
            drive -= symbol(f"{joint}.damping") * symbol(rate)
        forces.append(drive)
    inverse, acceleration = _accelerations(own, order, rates, parameters, sp.Matrix(forces))
    rows = {q: symbol(v) for q, v in zip(order, rates, strict=True)}
    rows |= {v: acceleration[k] for k, v in enumerate(rates)}
    place = [rates.index(name) if name in rates else None for name in states]
    columns = {j: tuple(sp.Integer(0) if r is None else inverse[r, k] for r in place) for k, j in enumerate(joints)}
    used = set().union(*(sp.sympify(e).free_symbols for e in (*rows.values(), *inverse)))
    kept = {n: p for n, p in parameters.items() if symbol(n) in used or n in GRAVITY}
    return SymbolicModel(
        states=tuple(Variable(n, s.unit) for n, s in states.items()),
        inputs=tuple(Variable(n, i.unit) for n, i in inputs.items()),
        parameters=kept,
        xdot=tuple(rows[n] for n in states),
        coordinates=tuple(map(Coordinate, joints, order, rates, units)),
        force_map=columns,
        named_parameters=_named_parameters(own["bodies"], kept),
        gravity=GRAVITY,
    )


def _accelerations(
    own: Mapping[str, Any], order: list[str], rates: list[str], parameters: Mapping[str, Parameter], forces: sp.Matrix
) -> tuple[sp.Matrix, sp.Matrix]:
    """M^-1, and the accelerations under these forces; of more than `MOST_DERIVED` joints with undefined functions."""
    if len(order) > MOST_DERIVED:
        inverse, at_rest = _undefined(order, rates, parameters)
        return inverse, inverse * (forces - at_rest)
    pull = np.array([symbol(name) for name in GRAVITY])
    tree = _tree(own, lambda name: symbol(name) if parameters[name].value else sp.Integer(0), pull)
    inverse, free = derive_accelerations(tree, order, rates)
    return inverse, free + inverse * forces


def multibody_plant(path: Path, gravity: tuple[float, float, float]) -> tuple[Any, list[str]]:
    """Drake's continuous `MultibodyPlant` of a file, its root welded to the world, and its moving joints in order.

    Raises:
        UserError: a file that Drake does not take, or a joint other than a hinge or a slide.
    """
    from pydrake.multibody.plant import MultibodyPlant

    logging.getLogger("drake").addFilter(_serious)
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector(list(gravity))
    add_welded(plant, path)
    joints = sorted(
        (plant.get_joint(k) for k in plant.GetJointIndices() if plant.get_joint(k).num_velocities()),
        key=lambda joint: joint.velocity_start(),
    )
    for joint in joints:
        if joint.type_name() not in ("revolute", "prismatic"):
            remedy = "Hinges (revolute, continuous) and slides (prismatic) are known."
            raise UserError(f"joint '{joint.name()}' is of type {joint.type_name()}", file=path, remedy=remedy)
    return plant, [j.name() for j in joints]


def add_welded(plant: Any, path: Path) -> None:
    """Put a model file into a `MultibodyPlant` that is not finalized, its root welded to the world, and finalize it.

    Raises:
        UserError: a file that Drake does not take.
    """
    from pydrake.multibody.parsing import Parser

    with loading("Drake", path):
        (model,) = Parser(plant).AddModels(path)
        root = root_link(path)
        if root != "world":
            plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root, model))
        plant.Finalize()


def _serious(record: logging.LogRecord) -> bool:
    """Drake warns, each time that it reads a file, of what it does not know there; `check` says once what matters."""
    return record.levelno > logging.WARNING


def _match(path: Path, states: Mapping[str, State], joints: list[str]) -> tuple[list[str], list[str]]:
    """The states that are the position and the velocity of each joint."""
    named = {(s.joint, s.quantity): n for n, s in states.items()}
    wanted = {(j, kind) for j in joints for kind in ("position", "velocity")}
    if named.keys() != wanted or len(named) != len(states):
        missing = sorted(wanted - named.keys())
        raise UserError(f"the states miss or repeat joint quantities {missing}", file=path, remedy="List each once.")
    return [named[j, "position"] for j in joints], [named[j, "velocity"] for j in joints]


def mechanism(path: Path) -> dict[str, Any]:
    """What Drake reads of a file that `urdf_checks.check_urdf` has taken, as plain data.

    Every stage asks for it, and importing Drake and reading takes a quarter of a second of CPU: it is kept in the cache
    folder, under digests of the file and of this module, and Drake's version.

    Returns:
        `bodies`: each that moves, with its inertial parameters (`m`, `cx`, `Ixx`, ...; about the origin of its frame).
        `joints`: each that moves, in order: `name`, `link`, `parent` (the joint before it, -1 for the base), `slides`,
        `axis`, `damping`, where its frame is on that of the parent's link (`turn`, `place`), and `carried`, the bodies
        welded to its link: name, rotation and origin of each on the link.

    Raises:
        UserError: a file that Drake does not take, or a joint other than a hinge or a slide.
    """
    own, read = (hashlib.sha256(reading.read_bytes(file)).hexdigest() for file in (Path(__file__), path))
    question = f"{own} {version('drake')} {read}"
    known: dict[str, Any] | None = recall("urdf", question)
    if known is None:
        plant, names = multibody_plant(path, (0.0, 0.0, 0.0))
        bodies = {body.name(): _inertia(body) for body in moving_bodies(plant)}
        known = {"bodies": bodies, "joints": _joints(plant, [plant.GetJointByName(name) for name in names])}
        remember("urdf", question, known)
    return known


def _inertia(body: Any) -> dict[str, float]:
    inertia = body.default_spatial_inertia()
    tensor = inertia.CalcRotationalInertia().CopyToFullMatrix3()  # about its frame's origin
    moments = (tensor[_AXES.index(m[1]), _AXES.index(m[2])] for m in _MOMENTS)
    return dict(zip(_INERTIAL, map(float, (inertia.get_mass(), *inertia.get_com(), *moments)), strict=True))


def _joints(plant: Any, joints: Sequence[Any]) -> list[dict[str, Any]]:
    context = plant.CreateDefaultContext()
    moving = (joint.child_body() for joint in joints)
    poses = {body.name(): _parts(body.EvalPoseInWorld(context)) for body in moving}
    carrier = {body.name(): k for k, j in enumerate(joints) for body in plant.GetBodiesWeldedTo(j.child_body())}
    found = []
    for joint in joints:
        parent, link = carrier.get(joint.parent_body().name(), -1), joint.child_body()
        base = poses[joints[parent].child_body().name()] if parent >= 0 else (np.eye(3), np.zeros(3))
        # at position 0 a joint's frame on its parent is that of the body that it moves
        own, mine = _parts(joint.frame_on_parent().CalcPoseInWorld(context)), poses[link.name()]
        slides = joint.type_name() == "prismatic"
        carried = [(body.name(), *_parts(body.EvalPoseInWorld(context))) for body in plant.GetBodiesWeldedTo(link)]
        found.append({
            "name": joint.name(),
            "link": link.name(),
            "parent": parent,
            "slides": slides,
            "axis": list(joint.translation_axis() if slides else joint.revolute_axis()),
            "damping": float(joint.default_damping()),
            "turn": (base[0].T @ own[0]).tolist(),
            "place": (base[0].T @ (own[1] - base[1])).tolist(),
            "carried": [
                (name, (mine[0].T @ turn).tolist(), (mine[0].T @ (at - mine[1])).tolist()) for name, turn, at in carried
            ],
        })  # fmt: skip
    return found


def _parts(pose: Any) -> tuple[Floats, Floats]:
    """Rotation and origin."""
    return np.array(pose.rotation().matrix()), np.array(pose.translation())


def _inertial_parameters(own: Mapping[str, Any]) -> dict[str, Parameter]:
    return {
        f"{name}.{key}": Parameter(values[key], unit, what.format(name))
        for name, values in own["bodies"].items()
        for key, (unit, what) in _INERTIAL.items()
    }


def moving_bodies(plant: Any) -> list[Any]:
    """Bodies that are not fixed to the world."""
    from pydrake.multibody.tree import BodyIndex

    bodies = (plant.get_body(BodyIndex(k)) for k in range(plant.num_bodies()))
    return [b for b in bodies if not plant.IsAnchored(b)]


def _named_parameters(links: Iterable[str], kept: Mapping[str, Parameter]) -> dict[str, NamedParameter]:
    named: dict[str, NamedParameter] = {}

    def add(name: str, unit: str, scaling: dict[str, int]) -> None:
        ratio, first = symbol("ratio"), next(iter(scaling))
        rule = {n: symbol(n) * ratio**power for n, power in scaling.items()}
        named[name] = NamedParameter(name, abs(kept[first].value), unit, rule)

    for link in links:
        com = [n for n in (f"{link}.c{a}" for a in _AXES) if n in kept]
        moments = [n for n in (f"{link}.{moment}" for moment in _MOMENTS) if n in kept]
        if f"{link}.m" in kept:  # a denser link of the same shape: its inertia scales along
            add(f"{link}.mass", "kg", dict.fromkeys([f"{link}.m", *moments], 1))
        if com:
            add(f"{link}.com", "m", dict.fromkeys(com, 1))
        if moments:
            add(f"{link}.inertia", "kg*m^2", dict.fromkeys(moments, 1))
        if com and moments:  # a longer link of the same mass
            add(f"{link}.length", "m", dict.fromkeys(com, 1) | dict.fromkeys(moments, 2))
    if kept[GRAVITY[2]].value:
        add("gravity", "m/s^2", dict.fromkeys(GRAVITY[::-1], 1))
    return named


MOST_DERIVED = 2
"""Largest number of joints whose equations are written out: two take 2 s of CPU, three 60 s."""


def _undefined(
    order: Sequence[str], rates: Sequence[str], parameters: Mapping[str, Parameter]
) -> tuple[sp.Matrix, sp.Matrix]:
    """W, n x n and symmetric, over positions and inertial parameters that are not 0, and h, n x 1, over all."""
    n, pull = len(order), [name for name in parameters if name.startswith("gravity_")]
    inertial = [k for k, p in parameters.items() if p.value and k not in pull and not k.endswith(".damping")]
    at = [symbol(name) for name in (*order, *inertial)]
    moving = [symbol(name) for name in (*order, *rates, *inertial, *pull)]
    inverse = sp.Matrix(n, n, lambda i, k: sp.Function(f"W_{min(i, k) + 1}_{max(i, k) + 1}", real=True)(*at))
    return inverse, sp.Matrix(n, 1, lambda i, _: sp.Function(f"h_{i + 1}", real=True)(*moving))


def load_tree(path: Path, gravity: float = 9.81) -> Tree:
    """The moving joints and bodies of a file that `urdf_checks.check_urdf` has taken.

    Args:
        path: the URDF; its root link is welded to the world.
        gravity: acceleration along -z, m/s^2.

    Raises:
        UserError: a joint other than a hinge or a slide.
    """
    own = mechanism(path)
    parameters = _inertial_parameters(own)
    return _tree(own, lambda name: parameters[name].value, np.array([0.0, 0.0, -gravity]))


@np.errstate(invalid="ignore")  # NumPy reads flags that arithmetic on expressions leaves
def _tree(own: Mapping[str, Any], value: Callable[[str], Any], gravity: Floats) -> Tree:
    """The joints and bodies of a mechanism, with each inertial parameter as a number or as an expression."""
    joints, inertial = own["joints"], []
    for joint in joints:
        whole = np.zeros(len(PARAMETERS))
        for body, turn, place in joint["carried"]:
            whole = whole + moved(_standard(body, value), np.array(turn), np.array(place))
        inertial.append(whole)
    return Tree(
        joints=tuple(joint["name"] for joint in joints),
        links=tuple(joint["link"] for joint in joints),
        parent=np.array([joint["parent"] for joint in joints], dtype=np.int64),
        turn=np.array([joint["turn"] for joint in joints]),
        place=np.array([joint["place"] for joint in joints]),
        axis=np.array([joint["axis"] for joint in joints]),
        slides=np.array([joint["slides"] for joint in joints]),
        inertial=np.array(inertial),
        damping=np.array([joint["damping"] for joint in joints]),
        gravity=gravity,
    )


def _standard(body: str, value: Callable[[str], Any]) -> Floats:
    """`model.tree.PARAMETERS` of a body, by the value of each of its inertial parameters."""
    own = {key: value(f"{body}.{key}") for key in _INERTIAL}
    return np.array([own[p] if p in own else own["m"] * own[f"c{p[1]}"] for p in PARAMETERS])


MOST_SIMPLIFIED = 250
"""Operations of a matrix that is simplified. Set on arms of packages: SymPy took 4 s for 203 of TwoJointRobot, 10 to 20
for 353 to 633 of a double pendulum, an iiwa and a Panda, more than 45 for 405 of another pair of the iiwa; a kernel
lost a third of its operations by it."""
SAME = 1e-10
"""Below it a coordinate is the whole number beside it: files write a right angle as 1.57079632679, 5e-12 off."""


@np.errstate(invalid="ignore")  # NumPy reads flags that arithmetic on expressions leaves
def derive_accelerations(tree: Tree, order: Sequence[str], rates: Sequence[str]) -> tuple[sp.Matrix, sp.Matrix]:
    """M(q)^-1, and the acceleration without forces, M^-1 (weight - C(q, v) v).

    Args:
        tree: its inertial parameters and its gravity as expressions.
        order, rates: names of its positions and velocities.
    """
    q, v = (np.array([[symbol(name) for name in names]]) for names in (order, rates))
    turning = np.vectorize(sp.sin, otypes=[object]), np.vectorize(sp.cos, otypes=[object])
    exact = {name: _exact(getattr(tree, name)) for name in ("turn", "place", "axis", "inertial")}
    arm = replace(tree, **exact)
    weightless, still, n = replace(arm, gravity=0 * arm.gravity), 0 * v, tree.size
    units = np.eye(n, dtype=object)
    squares = {sp.sin(s) ** 2: 1 - sp.cos(s) ** 2 for s in q[0]}

    def written(matrix: Floats) -> sp.Matrix:
        return sp.Matrix(matrix).applyfunc(lambda e: sp.expand(sp.expand(e).xreplace(squares)))

    upper = written(forces(weightless, q.repeat(n, axis=0), still.repeat(n, axis=0), units, turning))
    mass = sp.Matrix(n, n, lambda i, k: upper[min(i, k), max(i, k)])
    bias = written(forces(weightless, q, v, still, turning).T)
    weight = written(-forces(arm, q, still, still, turning).T)
    mass, bias, weight = (simplified(m, _shortest, "urdf 2") for m in (mass, bias, weight))
    inverse = simplified(mass, lambda m: _shortest(m.adjugate() / m.det()), "inverse 2")
    return inverse, simplified(inverse * (weight - bias), _shortest, "urdf 2")


def _exact(values: Any) -> Any:
    """Lengths, direction cosines and their products with symbols, in rationals."""

    def entry(value: Any) -> sp.Expr:
        e = sp.expand(sp.sympify(value))
        return e.xreplace({f: _rational(f) for f in e.atoms(sp.Float)})

    return np.vectorize(entry, otypes=[object])(values)


def _rational(value: sp.Float) -> sp.Rational:
    whole = round(value)
    return sp.Integer(whole) if abs(value - whole) < SAME else sp.nsimplify(round(float(value), 15), rational=True)


def _shortest(matrix: sp.Matrix) -> sp.Matrix:
    few = sum(int(sp.count_ops(e)) for e in matrix) <= MOST_SIMPLIFIED
    return matrix.applyfunc(sp.simplify) if few else matrix


_OPERATIONS = frozenset({"Add", "Mul", "Pow", "sin", "cos", "tan"})
_RULE = "1"  # of how it is written here


class _Other(ValueError):
    """An expression with something in it that is not written here."""


def simplified(matrix: sp.Matrix, how: Callable[[sp.Matrix], sp.Matrix], name: str) -> sp.Matrix:
    """`how(matrix)`, from the cache folder if it was made before.

    Args:
        matrix: in symbols as `model.symbolic.symbol` makes them; how: a function of nothing else.
        name: of the function and its version.
    """
    question = f"{_RULE} {sp.__version__} {name} {sp.srepr(matrix)}"
    with suppress(ValueError, KeyError, TypeError, RecursionError):  # nothing, or nothing that is written here
        known = recall("expressions", question)
        return sp.Matrix(*known["shape"], [_expression(e) for e in known["entries"]])
    made = how(matrix)
    with suppress(_Other, RecursionError):
        entries = [_written(e) for e in made]
        if [_expression(e) for e in entries] == list(made):
            remember("expressions", question, {"shape": made.shape, "entries": entries})
    return made


def _written(e: sp.Expr) -> Any:
    """A symbol as its name, a rational as its two whole numbers, an operation as a list."""
    if e.is_Symbol and e == symbol(e.name):
        return e.name
    if e.is_Rational:
        return {"p": str(e.p), "q": str(e.q)}
    name = type(e).__name__
    if name not in _OPERATIONS or getattr(sp, name) is not type(e):
        raise _Other(name)
    return [name, *(_written(a) for a in e.args)]


def _expression(node: Any) -> sp.Expr:
    if isinstance(node, str):
        return symbol(node)
    if isinstance(node, dict):
        return sp.Rational(int(node["p"]), int(node["q"]))
    if node[0] not in _OPERATIONS:
        raise _Other(node[0])
    return getattr(sp, node[0])(*(_expression(a) for a in node[1:]))
