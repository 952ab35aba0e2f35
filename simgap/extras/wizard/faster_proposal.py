"""A proposed game played faster, so that its torques are large beside the dry friction of the joints.

Without gravity, friction and damping the motion of an arm has no time of its own: with tau / s, speeds times s and
torques times s^2 it is the same game, cell by cell. Dry friction does not scale along, so a fast game feels less of it;
what gravity and damping do gets smaller beside the torques as well.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

from simgap.errors import UserError
from simgap.extras.wizard.driven_arm import rounded
from simgap.extras.wizard.proposal_games import Proposal

TIMES = 7.0
"""Largest input over the dry friction that it has to overcome, at least. A two-link arm with 7 and 21 wins .84 of its
cells with the gap, one with 10 at both joints and an obstacle .54; with a fifth it does not move at all."""

Range = tuple[float, float]


def quickened(
    found: Proposal, velocities: Collection[str], friction: Mapping[str, float], limits: Mapping[str, float],
    room: Mapping[str, Range],
) -> Proposal:  # fmt: skip
    """The proposal, faster if an input is less than TIMES the friction of its joint.

    Args:
        velocities: states that are speeds. friction: of the joint of each input that rubs. limits: largest inputs.
        room: for speeds that have one the interval to stay within.

    Raises:
        UserError: a drive that is too weak for its joint's friction, a speed that the joint does not allow, or a plant
            that is held at an unstable posture, whose time is its own.
    """
    half = {name: 0.5 * (hi - lo) for name, (lo, hi, _) in found.U.items()}
    ratio = {name: TIMES * force / half[name] for name, force in friction.items() if name in half}
    most = max(ratio, key=ratio.__getitem__, default=None)
    if most is None or ratio[most] <= 1.0:
        return found
    if found.target is None:
        if friction[most] <= 0.5 * half[most]:
            return found
        raise UserError(
            f"to hold the posture takes {half[most]:.2g} of {most}, the dry friction there is {friction[most]:g}",
            key="friction", remedy="A linear feedback does not move such a joint: lower the friction, or put tau and U "
            "in by hand.",
        )  # fmt: skip
    s = math.sqrt(ratio[most])
    inputs = {}
    for name, (lo, hi, step) in found.U.items():
        rest, steps = 0.5 * (lo + hi), round((hi - lo) / (2 * step))
        wide = rounded(step * s * s)
        needed = abs(rest) + steps * wide
        if needed > limits.get(name, math.inf):
            raise UserError(
                f"for {TIMES:g} times the dry friction that {most} feels ({friction[most]:g}) the game takes {name} "
                f"up to {needed:.2g}, and the drive gives {limits[name]:g}", key="friction",
                remedy="Give it a stronger drive, or less friction.",
            )  # fmt: skip
        inputs[name] = (round(rest - steps * wide, 12), round(rest + steps * wide, 12), wide)
    for name in velocities:
        lo, hi = room.get(name, (-math.inf, math.inf))
        if s * found.X[name][0] < lo or s * found.X[name][1] > hi:
            raise UserError(
                f"for {TIMES:g} times the dry friction that {most} feels ({friction[most]:g}) the game takes {name} "
                f"up to {s * found.X[name][1]:.2g}, and the joint's velocity limit is {hi:g}", key="friction",
                remedy="Is that its own limit (<limit velocity> of the URDF)? Else less friction, or tau, X, U by hand",
            )  # fmt: skip

    def scaled(box: Mapping[str, Range]) -> dict[str, Range]:
        return {n: (s * lo, s * hi) if n in velocities else (lo, hi) for n, (lo, hi) in box.items()}

    return replace(found, tau=rounded(found.tau / s), X=scaled(found.X), U=inputs, target=scaled(found.target))
