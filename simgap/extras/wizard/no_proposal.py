"""Why there is nothing to propose for a plant: inputs that move nothing, what no input moves, an X of no size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.extras.wizard.posture import Posture
from simgap.model.symbolic import SymbolicModel

NOTHING = 1e-3
"""Share of what is natural, or of the X that is sought, that is next to nothing: slips of units are of factors of a
thousand and more. Judgement."""
_MOVED, _STABLE, _PART = 1e-9, -1e-9, 0.1


def check_moved(model: SymbolicModel, posture: Posture) -> None:
    """Refuse inputs that move nothing at the posture, and a plant that changes by nothing.

    Raises:
        UserError: with the input, or the size of the rates.
    """
    idle = [n for n, own in zip(model.input_names, posture.b.T, strict=True) if not own.any()]
    if idle:
        words = f"{' and '.join(idle)} {'moves' if len(idle) == 1 else 'move'} nothing"
        raise UserError(
            f"{words} at this posture: no rate of change there depends on it", key=f"plant.inputs.{idle[0]}",
            remedy="Look at the equations' terms in it, leave it out, or name another posture (--at).",
        )  # fmt: skip
    largest = float(np.abs(posture.a * posture.scale / posture.scale[:, None]).max(initial=0.0))
    if 0.0 < largest < NOTHING * posture.rate:
        raise UserError(
            f"left to itself the plant all but stands still: within a second no state moves another by more than "
            f"{largest:.2g} of its natural size", key="plant",
            remedy="Look at the units of its equations and parameters: rates are a second, angles in rad.",
        )  # fmt: skip


def unmoved(model: SymbolicModel, posture: Posture) -> str:
    """What of the plant grows and is moved by no input, as a clause: by the left eigenvectors of its linear model.

    (Hautus 1969: an unstable eigenvalue whose left eigenvector the inputs do not see.)
    """
    b = posture.b * posture.strength / posture.scale[:, None]
    values, vectors = np.linalg.eig((posture.a * posture.scale / posture.scale[:, None]).T)
    for value, w in zip(values, vectors.T, strict=True):
        if value.real > _STABLE * posture.rate and np.abs(w @ b).max(initial=0.0) < _MOVED * posture.rate:
            share = np.abs(w) / np.abs(w).max()
            names = [n for n, own in zip(model.state_names, share, strict=True) if own > _PART]
            does = "does" if len(names) == 1 else "do together"
            return f"what {' and '.join(names)} {does} is moved by no input"
    return "its inputs do not move all of what is unstable"


def check_room(names: Sequence[str], sought: Floats, room: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a state whose room is next to nothing of the X that is sought, half-widths (n,).

    Raises:
        UserError: with the room's ends.
    """
    for n, aim in zip(names, sought, strict=True):
        lo, hi = room.get(n, (-math.inf, math.inf))
        if hi - lo < 2.0 * NOTHING * aim:
            raise UserError(
                f"{n} has no room: its limits are {lo:g} and {hi:g}, where +-{aim:.2g} is sought", key=f"domain.X.{n}",
                remedy="Look at the joint's <limit> in the URDF and its unit.",
            )  # fmt: skip


def check_strength(names: Sequence[str], most: Floats, wanted: Floats) -> None:
    """Refuse inputs of which all can be next to nothing of what would keep the X that is sought, both (m,).

    Raises:
        UserError: with both.
    """
    share = float((most / np.where(wanted > 0, wanted, math.inf)).max(initial=0.0)) if len(most) else 1.0
    if share >= NOTHING:
        return
    given = ", ".join(f"{n} +-{v:.2g}" for n, v in zip(names, most, strict=True))
    needed = ", ".join(f"{n} +-{v:.2g}" for n, v in zip(names, wanted, strict=True))
    raise UserError(
        f"the inputs move next to nothing: {given} is allowed where {needed} would be sought", key="domain.U",
        remedy="Allow larger ones (domain.U, or <limit effort> in the URDF), or look at the units of the equations' "
        "terms in them.",
    )  # fmt: skip
