"""Changes that an engine makes to a model file in silence: what it drops, replaces, completes or enforces.

Two engines read one URDF as two robots. Some of it can be asked of the loaded engine (masses, centres of mass,
moments of inertia); the rest, what it does with friction, limits and gears, is a trait of the engine that a test shows.
Nothing here is refused: gamma covers what the simulator does. It is said, so that nobody takes it for the robot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.effects import effect, joint_effect
from simgap.errors import Finding
from simgap.plants.model_file import FileJoint, Link, ModelFile
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
        if name in file.bare and own.mass > 0:
            yield Finding(
                f"link '{name}'",
                f"the file gives it no mass, the engine gives it {own.mass:g} kg",
                "Add <inertial> to it.",
            )
        declared = file.links.get(name)
        if declared is None:
            continue
        if differs(own.mass, declared.mass):
            yield Finding(
                f"link '{name}'", f"the engine computes with {own.mass:g} kg, the file says {declared.mass:g} kg",
                "Give simulator.urdf the mass that is meant.",
            )  # fmt: skip
        if differs(own.com, declared.com):
            yield Finding(
                f"link '{name}'",
                f"the engine has its centre of mass at {listed(own.com)} m, the file at {listed(declared.com)} m",
                "Look at <inertial><origin>.",
            )
        if differs(own.moments, declared.moments):
            by_key = getattr(case.simulator, "inertia", None) == "engine"
            which = f"link '{name}'" if by_key else "it"
            yield Finding(
                "simulator.inertia" if by_key else f"link '{name}'",
                f"the engine computes {which} with the principal moments "
                f"{listed(own.moments)} kg m^2, the file says {listed(declared.moments)}",
                "With `inertia: file` it takes the file's." if by_key else "Look at <inertia>.",
            )


def _damping(case: Case, traits: FileTraits, file: ModelFile) -> Iterator[Finding]:
    own = getattr(case.simulator, "damping", None)
    if own is None:
        return
    for name, joint in file.joints.items():
        engine = own.joint + _viscous(case, name)
        if differs(joint.damping, engine):
            yield Finding(
                "simulator.damping.joint",
                f"replaces the damping {joint.damping:g} that the file states for joint '{name}' by {engine:g}; the "
                "nominal model keeps the file's",
                _agreeing(name, joint.damping, {own.damping for own in file.joints.values()}),
            )
    if traits.damps_links and (own.linear or own.angular):
        yield Finding(
            "simulator.damping",
            f"the engine damps every link by {own.linear:g} (linear) and {own.angular:g} (angular) 1/s, although no "
            "model file says so",
            "Set both to 0, unless you want to measure the engine with its defaults.",
        )


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
    place = f"joint '{name}'"
    if joint.friction > 0 and not _declared(case, name):
        yield Finding(
            place, f"neither Drake nor the engine simulates its friction {joint.friction:g}",
            "Declare coulomb_friction in simulator.effects, and in plant.effects if the model should know it.",
        )  # fmt: skip
    if joint.mimics is not None:
        yield Finding(
            place, f"the file lets it follow joint '{joint.mimics}', the engine moves it independently",
            "Weld or remove it, or give it states.",
        )  # fmt: skip
    if joint.reflected:
        yield Finding(
            place, "the file states a gear or a rotor's inertia, which the engine drops",
            "Add the reflected inertia to the link, or let gamma cover it.",
        )  # fmt: skip
    yield from ranges(case, traits, name, joint)
    yield from efforts(case, name, joint)


def _declared(case: Case, joint: str) -> bool:
    """True if an effect of the simulator is some dry friction of a joint."""
    return any(e.on == joint and effect(e.name).dry for e in added_effects(case))


def ranges(case: Case, traits: FileTraits, name: str, joint: FileJoint) -> Iterator[Finding]:
    """Findings where X asks of a joint more than the file lets it do."""
    for state, section in case.plant.states.items():
        if section.joint != name:
            continue
        lo, hi = domain_of(case).X[state]
        key, fastest = f"domain.X.{state}", max(abs(lo), abs(hi))
        if section.quantity == "position" and joint.range is not None and traits.stops:
            least, most = joint.range
            if least <= most and (lo < least or hi > most):
                yield Finding(
                    key, f"reaches beyond the range [{least:g}, {most:g}] of joint '{name}', where the engine stops it "
                    "and the nominal model does not",
                    "Keep X inside the range, with room for one step.",
                )  # fmt: skip
            elif least < most and any(to_stop(case, state, end) for end in joint.range):
                yield Finding(
                    key, f"comes within {_travel(case, state):.3g} of the stops at {least:g} and {most:g} of joint "
                    f"'{name}', which is what it travels in one step at its fastest: the engine stops it there and the "
                    "nominal model does not",
                    "Keep X farther inside, or fewer speeds in X.",
                )  # fmt: skip
        if section.quantity != "velocity":
            continue
        if joint.velocity is not None and fastest > joint.velocity:
            yield Finding(
                key, (
                    f"reaches {fastest:g}, joint '{name}' is limited to {joint.velocity:g}, but neither Drake nor "
                    "the engine enforces that"
                ),
                "Keep X within it, or correct the file.",
            )  # fmt: skip
        if traits.fastest is not None and fastest >= traits.fastest:
            yield Finding(
                key, f"reaches {fastest:g}, the engine limits every joint's speed to {traits.fastest:g}",
                "Keep X below it.",
            )  # fmt: skip


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


def efforts(case: Case, name: str, joint: FileJoint) -> Iterator[Finding]:
    """Findings where U asks of a joint more than the file says that it takes."""
    for drive, section in case.plant.inputs.items():
        if section.joint == name and joint.effort is not None:
            most = float(np.abs(domain_of(case).U[drive].list()).max())
            if most > joint.effort:
                yield Finding(
                    f"domain.U.{drive}",
                    f"reaches {most:g}, joint '{name}' is limited to {joint.effort:g}, but neither Drake nor the "
                    "engine enforces that",
                    "Keep U within it, or declare saturation in simulator.effects.",
                )


def differs(a: Floats | float, b: Floats | float) -> bool:
    """True if two numbers, or two lists of them, are not the same up to `SAME`."""
    size = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return bool(np.abs(np.asarray(a) - b).max() > SAME * size)


def listed(values: Floats) -> str:
    """Numbers in brackets."""
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
