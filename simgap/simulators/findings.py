"""Surprises of a model file: what an engine drops, replaces or enforces in silence, and what MJCF has beyond the model.

Two engines read one URDF as two robots. Some of it can be asked of the loaded engine (masses, centres of mass,
moments of inertia); the rest, what it does with friction, limits and gears, is a trait of the engine that a test shows.
Bodies of an MJCF file and of the plant's URDF need not have the same names or frames. What is compared is what a joint
feels: the mass and the inertia that it moves, the pull of gravity, and its own damping, friction, armature, spring and
stops. Nothing here is refused: gamma covers what the simulator does. It is said, so that nobody takes it for the robot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.effects import effect, joint_effect
from simgap.errors import Finding
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.model.tree import forces
from simgap.plants.model_file import FileJoint, Link, ModelFile, read_model_file
from simgap.plants.urdf import load_tree
from simgap.simulators import mjcf
from simgap.simulators.base import FileTraits, added_effects, domain_of

SAME = 1e-3
"""Relative difference up to which two numbers are the same: files round to that."""


def model_file_findings(case: Case, traits: FileTraits, file: ModelFile, loaded: Mapping[str, Link]) -> list[Finding]:
    """All findings for the model file that the engine loads.

    Args:
        case: with a simulator and a domain.
        traits: of its engine; file: the model file that it loads; loaded: links as the engine computes with them.
    """
    found = [*_links(case, file, loaded), *_damping(case, traits, file)]
    for name, joint in file.joints.items():
        found += _joint(case, traits, name, joint)
    return found


def _links(case: Case, file: ModelFile, loaded: Mapping[str, Link]) -> Iterator[Finding]:
    for name, own in loaded.items():
        key, declared = f"link '{name}'", file.links.get(name)
        if name in file.bare and own.mass > 0:
            problem = f"the file gives it no mass, the engine gives it {own.mass:g} kg"
            yield Finding(key, problem, "Add <inertial> to it.")
        if declared is None:
            continue
        if differs(own.mass, declared.mass):
            problem = f"the engine computes with {own.mass:g} kg, the file says {declared.mass:g} kg"
            yield Finding(key, problem, "Give simulator.urdf the mass that is meant.")
        if differs(own.com, declared.com):
            problem = f"the engine has its centre of mass at {_list(own.com)} m, the file at {_list(declared.com)} m"
            yield Finding(key, problem, "Look at <inertial><origin>.")
        if differs(own.moments, declared.moments):
            by_key = getattr(case.simulator, "inertia", None) == "engine"
            problem = (
                f"the engine computes {key if by_key else 'it'} with the principal moments {_list(own.moments)} kg "
                f"m^2, the file says {_list(declared.moments)}"
            )
            remedy = "With `inertia: file` it takes the file's." if by_key else "Look at <inertia>."
            yield Finding("simulator.inertia" if by_key else key, problem, remedy)


def _damping(case: Case, traits: FileTraits, file: ModelFile) -> Iterator[Finding]:
    own = getattr(case.simulator, "damping", None)
    if own is None:
        return
    for name, joint in file.joints.items():
        engine = own.joint + _viscous(case, name)
        if differs(joint.damping, engine):
            problem = (
                f"replaces the damping {joint.damping:g} that the file states for joint '{name}' by {engine:g}; the "
                "nominal model keeps the file's"
            )
            stated = {other.damping for other in file.joints.values()}
            yield Finding("simulator.damping.joint", problem, _agreeing(name, joint.damping, stated))
    if traits.damps_links and (own.linear or own.angular):
        problem = (
            f"the engine damps every link by {own.linear:g} (linear) and {own.angular:g} (angular) 1/s, although no "
            "model file says so"
        )
        remedy = "Set both to 0, unless you want to measure the engine with its defaults."
        yield Finding("simulator.damping", problem, remedy)


def _viscous(case: Case, joint: str) -> float:
    """Damping of a joint by declared effects, beside the one number of the engine."""
    viscous = joint_effect("damping")
    own = [e.parameters for e in added_effects(case) if e.on == joint and e.name == viscous.name]
    return sum(values.get(viscous.parameters[0].symbol, 0.0) for values in own)


def _agreeing(name: str, own: float, stated: Collection[float]) -> str:
    """Remedy that makes engine and model agree on the damping of a joint, where one key is that of all joints."""
    least = min(stated)
    if len(stated) == 1:
        return f"Set it to {own:g} if the two should agree."
    if own == least:
        return f"Set it to {own:g}, the least of the joints, if the two should agree."
    return (
        f"It is one number for joints that differ: set it to {least:g}, the least, and give '{name}' viscous_friction "
        f"of {own - least:g} in simulator.effects, if the two should agree."
    )


def _joint(case: Case, traits: FileTraits, name: str, joint: FileJoint) -> Iterator[Finding]:
    key = f"joint '{name}'"
    if joint.friction > 0 and not any(e.on == name and effect(e.name).dry for e in added_effects(case)):
        problem = f"neither Drake nor the engine simulates its friction {joint.friction:g}"
        remedy = "Declare coulomb_friction in simulator.effects, and in plant.effects if the model should know it."
        yield Finding(key, problem, remedy)
    if joint.mimics is not None:
        problem = f"the file lets it follow joint '{joint.mimics}', the engine moves it independently"
        yield Finding(key, problem, "Weld or remove it, or give it states.")
    if joint.reflected:
        problem = "the file states a gear or a rotor's inertia, which the engine drops"
        yield Finding(key, problem, "Add the reflected inertia to the link, or let gamma cover it.")
    yield from _ranges(case, traits, name, joint)
    yield from _efforts(case, name, joint)


def _ranges(case: Case, traits: FileTraits, name: str, joint: FileJoint) -> Iterator[Finding]:
    """Findings where X asks of a joint more than the file lets it do."""
    for state, section in case.plant.states.items():
        if section.joint != name:
            continue
        lo, hi = domain_of(case).X[state]
        key, fastest = f"domain.X.{state}", max(abs(lo), abs(hi))
        if section.quantity == "position" and joint.range is not None and traits.stops:
            least, most = joint.range
            if least <= most and (lo < least or hi > most):
                problem = (
                    f"reaches beyond the range [{least:g}, {most:g}] of joint '{name}', where the engine stops it "
                    "and the nominal model does not"
                )
                yield Finding(key, problem, "Keep X inside the range, with room for one step.")
            elif least < most and any(to_stop(case, state, end) for end in joint.range):
                problem = (
                    f"comes within {_travel(case, state):.3g} of the stops at {least:g} and {most:g} of joint "
                    f"'{name}', which is what it travels in one step at its fastest: the engine stops it there and the "
                    "nominal model does not"
                )
                yield Finding(key, problem, "Keep X farther inside, or fewer speeds in X.")
        if section.quantity != "velocity":
            continue
        if joint.velocity is not None and fastest > joint.velocity:
            problem = f"reaches {fastest:g}, joint '{name}' is limited to {joint.velocity:g}, {UNENFORCED}"
            yield Finding(key, problem, "Keep X within it, or correct the file.")
        if traits.fastest is not None and fastest >= traits.fastest:
            problem = f"reaches {fastest:g}, the engine limits every joint's speed to {traits.fastest:g}"
            yield Finding(key, problem, "Keep X below it.")


def to_stop(case: Case, state: str, end: float) -> bool:
    """True if one step at the largest speed of X leads from X to a stop of the joint whose position `state` is."""
    lo, hi = domain_of(case).X[state]
    travel = _travel(case, state)
    return lo - travel < end < hi + travel


def _travel(case: Case, state: str) -> float:
    """Way of the joint of a position in one step at the largest speed of X."""
    joint = case.plant.states[state].joint
    speeds = [n for n, s in case.plant.states.items() if s.joint == joint and s.quantity == "velocity"]
    return domain_of(case).tau * max((abs(v) for n in speeds for v in domain_of(case).X[n]), default=0.0)


UNENFORCED = "but neither Drake nor the engine enforces that"


def _efforts(case: Case, name: str, joint: FileJoint) -> Iterator[Finding]:
    """Findings where U asks of a joint more than the file says that it takes."""
    for drive, section in case.plant.inputs.items():
        if section.joint == name and joint.effort is not None:
            most = float(np.abs(domain_of(case).U[drive].list()).max())
            if most > joint.effort:
                problem = f"reaches {most:g}, joint '{name}' is limited to {joint.effort:g}, {UNENFORCED}"
                remedy = "Keep U within it, or declare saturation in simulator.effects."
                yield Finding(f"domain.U.{drive}", problem, remedy)


def differs(a: Floats | float, b: Floats | float) -> bool:
    """True if two numbers, or two lists of them, are not the same up to `SAME`."""
    size = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return bool(np.abs(np.asarray(a) - b).max() > SAME * size)


def _list(values: Floats) -> str:
    """Numbers in brackets."""
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


@dataclass(frozen=True)
class Felt:
    """Load of a joint: mass that it moves, kg; inertia at 0, kg m^2 or kg; gravity's pull at states, N m or N."""

    mass: float
    inertia: float
    gravity: Floats


def load_of_file(case: Case, model: Any) -> Mapping[str, Felt]:
    """Load of each joint of MuJoCo's model, by name; gravity at the states of `mjcf.samples`."""
    mujoco = mjcf.require_mujoco()
    nv, pulls = model.nv, []
    for x in mjcf.samples(case):
        data = mjcf.data_at_state(case, model, x)
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        pulls.append(np.array(data.qfrc_gravcomp) - np.array(data.qfrc_bias))
    data, inertia = mujoco.MjData(model), np.empty(nv)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    bias = np.empty(nv)
    mujoco.mj_rne(model, data, 0, bias)
    for k in range(nv):  # a column of the mass matrix, without armature
        data.qacc[:] = np.eye(nv)[k]
        column = np.empty(nv)
        mujoco.mj_rne(model, data, 1, column)
        inertia[k] = column[k] - bias[k]
    return {
        model.joint(j).name: Felt(
            float(model.body_subtreemass[model.jnt_bodyid[j]]),
            float(inertia[k := int(model.jnt_dofadr[j])]),
            np.array([pull[k] for pull in pulls]),
        )
        for j in range(model.njnt)
    }


def load_of_nominal(case: Case, urdf: Path) -> Mapping[str, Felt]:
    """The same of the plant's URDF."""
    tree = load_tree(urdf, case.plant.gravity)
    n, place = tree.size, {s.joint: name for name, s in case.plant.states.items() if s.quantity == "position"}
    still, q = np.zeros((n, n)), np.array([[x[place[joint]] for joint in tree.joints] for x in mjcf.samples(case)])
    inertia = forces(replace(tree, gravity=np.zeros(3)), still, still, np.eye(n)).diagonal()
    pulls = np.round(-forces(tree, q, np.zeros_like(q), np.zeros_like(q)), 12)  # what is rounding is no pull
    moved = tree.inertial[:, 0].copy()  # by each joint: its own body, and what hangs on that
    for k in reversed(range(n)):
        if tree.parent[k] >= 0:
            moved[tree.parent[k]] += moved[k]
    return {name: Felt(float(moved[k]), float(inertia[k]), pulls[:, k]) for k, name in enumerate(tree.joints)}


LEARN = "Declare {} in plant.effects if the model should know it; gamma covers it otherwise."
COVERED = "Correct the MJCF file or the URDF, unless that is the gap you want to measure."


def mjcf_findings(case: Case, folder: Path) -> list[Finding]:
    """All of them, for a case whose file `mjcf.check_mjcf` takes.

    Raises:
        UserError: what it refuses.
    """
    model = mjcf.check_mjcf(case, folder)
    joints = [model.joint(k).name for k in range(model.njnt)]
    found = [*_options(case, model), *_touching(case, model), *_idle(model)]
    for name in joints:
        joint = _as_stated(model, name)
        found += [*_ranges(case, FileTraits(), name, joint), *_efforts(case, name, joint)]
    if case.plant.urdf is not None:
        stated = read_model_file(folder / case.plant.urdf).joints
        nominal = load_of_nominal(case, folder / case.plant.urdf)
        for name, own in load_of_file(case, model).items():
            found += [*_body(name, own, nominal[name]), *_own_forces(case, model, name, stated[name].damping)]
    return found


def mjcf_switches(case: Case, folder: Path) -> tuple[sp.Expr, ...]:
    """Surfaces where the file's stops and dry friction switch, as expressions that are 0 there.

    Raises:
        UserError: what `mjcf.check_mjcf` refuses.
    """
    model, found = mjcf.check_mjcf(case, folder), []
    for name, state in case.plant.states.items():
        if state.joint is None:
            continue
        joint = model.joint(state.joint)
        if state.quantity == "velocity" and model.dof_frictionloss[joint.dofadr[0]] > 0:
            found.append(symbol(name))
        if state.quantity == "position" and model.jnt_limited[joint.id]:
            found += [symbol(name) - sp.Float(float(end)) for end in model.jnt_range[joint.id]]
    return tuple(found)


def _as_stated(model: Any, name: str) -> FileJoint:
    joint = model.joint(name)
    return FileJoint(
        kind="revolute",
        range=(float(joint.range[0]), float(joint.range[1])) if model.jnt_limited[joint.id] else None,
        effort=most_force(model, joint.id),
        velocity=None, damping=0.0, friction=0.0, mimics=None, reflected=False,
    )  # fmt: skip


def motors_of(model: Any, joint: int) -> Iterator[int]:
    """The actuators on a joint."""
    kind = mjcf.require_mujoco().mjtTrn.mjTRN_JOINT
    yield from (k for k in range(model.nu) if model.actuator_trntype[k] == kind and model.actuator_trnid[k, 0] == joint)


def most_force(model: Any, joint: int) -> float | None:
    """The largest force on a joint that its motors say they give, None where one says nothing."""
    total, some = 0.0, False
    for k in motors_of(model, joint):
        ends = []
        if model.actuator_ctrllimited[k]:
            ends.append(float(np.abs(model.actuator_ctrlrange[k] * model.actuator_gainprm[k, 0]).max()))
        if model.actuator_forcelimited[k]:
            ends.append(float(np.abs(model.actuator_forcerange[k]).max()))
        if not ends:
            return None
        total, some = total + min(ends) * abs(float(model.actuator_gear[k, 0])), True
    return total if some else None


def _idle(model: Any) -> Iterator[Finding]:
    for k in range(model.nu):
        gear = float(model.actuator_gear[k, 0]) * float(model.actuator_gainprm[k, 0])
        if gear != 1.0:
            problem = f"it makes {gear:g} of a command of 1, and idles: the inputs of the case are forces on joints"
            yield Finding(f"actuator '{model.actuator(k).name}'", problem, "Give U in the joint's unit.")


def _options(case: Case, model: Any) -> Iterator[Finding]:
    assert case.simulator is not None
    tau, option, mujoco = domain_of(case).tau, model.opt, mjcf.require_mujoco()
    step = tau / case.simulator.substeps
    if differs(option.timestep, step):
        problem = f"the file steps by {option.timestep:g} s, the engine by tau/substeps = {step:g} s"
        remedy = f"substeps: {max(1, round(tau / option.timestep))} is nearest to the file."
        yield Finding("simulator.substeps", problem, remedy)
    own, model_s = mjcf.gravity_of(model), np.array([0.0, 0.0, -case.plant.gravity])
    if case.plant.urdf is not None and differs(own, model_s):
        problem = f"its gravity is {_list(own)} m/s^2, the nominal model's {_list(model_s)}"
        yield Finding(mjcf.KEY, problem, "Correct <option gravity>, or plant.gravity.")
    if option.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        name = mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_").lower()
        yield Finding(mjcf.KEY, f"it integrates by {name}, as its <option> says", "That is used; nothing to do.")
    if option.density or option.viscosity or np.any(option.wind):
        yield Finding(mjcf.KEY, "its bodies move through a medium, which resists", LEARN.format("drag"))
    bits = [b for b in mujoco.mjtDisableBit.__members__.values() if b.name not in ("mjDSBL_AUTORESET", "mjNDISABLE")]
    off = [b.name.removeprefix("mjDSBL_").lower() for b in bits if option.disableflags & b.value]
    if off:
        yield Finding(mjcf.KEY, f"its <flag> switches off: {', '.join(off)}", "Take it out if it is not meant.")
    if model.neq:
        problem = f"it has {model.neq} equality constraints, the nominal model none"
        yield Finding(mjcf.KEY, problem, "Take them out, unless that is the gap you want to measure.")


def _touching(case: Case, model: Any) -> Iterator[Finding]:
    """Shapes that touch in X: a world's shape and the body that is hinged to it touch too, unlike two bodies."""
    for x in mjcf.samples(case):
        data = mjcf.data_at_state(case, model, x)
        if data.ncon:
            pair = " and ".join(_shape(model, int(g[0])) for g in (data.contact.geom1, data.contact.geom2))
            place = ", ".join(f"{name} = {value:.3g}" for name, value in x.items())
            remedy = 'Give one of them contype="0" conaffinity="0", unless the contact is meant.'
            yield Finding(mjcf.KEY, f"{pair} touch at {place}, which pushes them apart", remedy)
            return


def _shape(model: Any, geom: int) -> str:
    name = model.geom(geom).name
    body = model.body(int(model.geom_bodyid[geom])).name
    return f"geom '{name}'" if name else f"a geom of body '{body}'"


def _body(name: str, own: Felt, nominal: Felt) -> Iterator[Finding]:
    key = f"joint '{name}'"
    if differs(own.mass, nominal.mass):
        yield Finding(key, f"it moves {own.mass:g} kg in the file, {nominal.mass:g} kg in the plant's URDF", COVERED)
    if differs(own.inertia, nominal.inertia):
        problem = f"it moves an inertia of {own.inertia:.4g} in the file, {nominal.inertia:.4g} in the plant's URDF"
        yield Finding(key, f"{problem}, both where all positions are 0, in SI units", COVERED)
    if differs(own.gravity, nominal.gravity):
        k = int(np.argmax(np.abs(own.gravity - nominal.gravity)))
        problem = (
            f"gravity pulls it by {own.gravity[k]:.4g} in the file and by {nominal.gravity[k]:.4g} in the plant's URDF "
            "at the same position: another mass, place of it, axis or zero"
        )
        yield Finding(key, problem, COVERED)


def _own_forces(case: Case, model: Any, name: str, damping: float) -> Iterator[Finding]:
    """Findings about what acts in a joint itself, with what the case adds to either side."""
    assert case.simulator is not None
    joint, place = model.joint(name), f"joint '{name}'"
    k = int(joint.dofadr[0])
    stated = (
        ("damps it by", "damping", float(model.dof_damping[k]), damping),
        ("holds it with dry friction of", "frictionloss", float(model.dof_frictionloss[k]), 0.0),
        ("gives it an armature of", "armature", float(model.dof_armature[k]), 0.0),
        ("ties it to a spring of", "stiffness", float(model.jnt_stiffness[joint.id]), 0.0),
    )
    for words, attribute, own, nominal in stated:
        known = joint_effect(attribute)
        key = known.parameters[0].symbol
        sides = [
            value + sum(e.parameters.get(key, 0.0) for e in effects if e.name == known.name and e.on == name)
            for value, effects in ((own, case.simulator.effects), (nominal, case.plant.effects))
        ]
        if own and differs(*sides):
            problem = f"the file {words} {own:g}, the nominal model has {sides[1]:g}"
            yield Finding(place, problem, LEARN.format(known.name))
        elif nominal and differs(*sides):
            problem = f"the plant's URDF {words} {nominal:g}, the simulator has {sides[0]:g}"
            yield Finding(place, problem, COVERED)
    if np.any(model.dof_dampingpoly[k]) or np.any(model.jnt_stiffnesspoly[joint.id]):
        remedy = LEARN.format("quadratic_drag or cubic_spring")
        yield Finding(place, "the file gives it damping or a spring of higher order", remedy)
