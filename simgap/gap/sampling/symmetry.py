"""Symmetries that a case declares: measured in the simulator, and their largest deviation added to the bound.

A cart's gap does not depend on where it stands (translation), a robot's on place and heading when it is seen from its
own frame (planar). States of a translation are not sampled: the grid has one cell along them, and the bound is a
function of the others. Random states are rolled out at the middle of these axes, at their ends and at random places
along them; equal histories of a robot are repeated at other headings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise
from simgap.gap.bounds.function import Tier
from simgap.gap.sampling.points import free_axes
from simgap.plants.context import Context

ENDS = 2
"""Shifts that go to the ends of the axes, if there are as many."""
_PLANAR = " in the simulator: between headings"
_REGULAR_CONTACTS = (
    "Make contacts regular: each wheel a sphere (a cylinder's edge jitters), a caster that slides "
    "(<lateral_friction> 0 to 0.02), more grip, less torque; raise the tolerance knowingly, or remove `symmetry`"
)


def shifted_states(context: Context) -> Floats:
    """Random states, each at the middle of the free axes and then at its shifts: (histories * (1 + headings), nx).

    Raises:
        UserError: a case without symmetry.
    """
    symmetry = context.need(context.case.symmetry, "symmetry")
    free, box, rng = list(free_axes(context.case)), context.box, np.random.default_rng(symmetry.seed)
    states = np.repeat(box.sample(rng, symmetry.histories)[:, None], 1 + symmetry.headings, axis=1)
    places = rng.uniform(box.lo[free], box.hi[free], (symmetry.histories, symmetry.headings, len(free)))
    for k, end in enumerate((box.lo, box.hi)):
        if symmetry.headings > ENDS:
            places[:, k] = end[free]
    states[:, 1:, free] = places
    states[:, 0, free] = 0.5 * (box.lo + box.hi)[free]
    return states.reshape(-1, box.size)


@dataclass(frozen=True, eq=False)
class SymmetryDeviation:
    """Largest difference of the gap between states that a declared symmetry takes to each other.

    Attributes:
        largest: (nx,) from the gap at the middle of the axes, or at heading 0. samples: roll-outs compared.
        along: the states of a translation; none for the symmetry of the plane.
    """

    largest: Floats
    samples: int
    along: tuple[str, ...] = ()

    @staticmethod
    def of_translation(context: Context, lower: Floats, upper: Floats) -> SymmetryDeviation:
        """From both ends of the gap, (n, nx), at `shifted_states` with every input.

        Raises:
            UserError: a case without symmetry.
        """
        symmetry = context.need(context.case.symmetry, "symmetry")
        shape = (symmetry.histories, 1 + symmetry.headings, len(context.input_set), lower.shape[1])
        ends = [own.reshape(shape) for own in (lower, upper)]
        below, above = (np.abs(own[:, 1:] - own[:, :1]).max(axis=(0, 1, 2)) for own in ends)
        return SymmetryDeviation(np.maximum(below, above), len(lower), symmetry.along)

    @staticmethod
    def of_headings(reference: Floats, turned: Floats) -> SymmetryDeviation:
        """From final body-frame poses at heading 0 (n, 3) and at other headings (h, n, 3)."""
        off = np.abs(turned - reference[None])
        return SymmetryDeviation(off.max(axis=(0, 1)), int(off.shape[0] * off.shape[1]))

    def check(self, states: Sequence[str], tolerance: Mapping[str, float], stops: Sequence[str] = ()) -> None:
        """Refuse a deviation above the tolerance of the case; `stops` says which joints X takes to their stops.

        Raises:
            BrokenPromise: naming the state, the deviation and the tolerance.
        """
        for name, value in zip(states, self.largest, strict=True):
            if value > tolerance[name]:
                where = f": between places along {', '.join(self.along)}" if self.along else _PLANAR
                at_stops = f"; X goes to the stops of {' and '.join(stops)}" if stops else ""
                shrink = "Keep X a step's travel away from the stops, or leave" if stops else "Leave"
                keep_out = f"{shrink} the state out of symmetry.along, or raise the tolerance knowingly"
                raise BrokenPromise(
                    f"the declared symmetry does not hold{where} the gap in {name} deviates by {value:.3g}, "
                    f"symmetry.tolerance allows {tolerance[name]:.3g}{at_stops}",
                    keep_out if self.along else _REGULAR_CONTACTS,
                )

    def tier(self, states: Sequence[str]) -> Tier:
        """The deviation that was added to the bound, as a statement of its guarantee."""
        added = ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, self.largest, strict=True))
        if not self.along:
            return Tier(
                2,
                "The gap is assumed to depend on position and heading through the robot's own frame only. The engine "
                f"keeps this symmetry only approximately: among {self.samples:,} roll-outs repeated at random headings "
                f"the largest deviation was {added}; that is added to the bound and is an estimate.",
            )
        return Tier(
            2,
            f"The gap is assumed not to depend on {', '.join(self.along)}. Among {self.samples:,} roll-outs repeated "
            f"at other places along {'it' if len(self.along) == 1 else 'them'}, the ends of X included, the largest "
            f"deviation was {added}; that is added to the bound and is an estimate.",
        )
