"""A gap that does not depend on some states: declared in the case, measured on shifted states, the deviation added.

A cart's gap does not depend on where it stands, nor a frictionless one's on how fast it goes. Such states are not
sampled: the grid has one cell along them, and the bound is a function of the others. Whether that is so is measured:
random states are rolled out at the middle of these axes, at their ends and at random places along them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise
from simgap.gap.bounds.tiers import Tier
from simgap.gap.sampling.points import free_axes
from simgap.plants.context import Context

ENDS = 2
"""Shifts that go to the ends of the axes, if there are as many."""


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
class ShiftDeviation:
    """By how much the gap differs between shifts.

    Attributes:
        largest: (nx,) largest difference from the gap at the middle. samples: roll-outs compared. along: the states.
    """

    largest: Floats
    samples: int
    along: tuple[str, ...]

    @staticmethod
    def of(context: Context, lower: Floats, upper: Floats) -> ShiftDeviation:
        """From both ends of the gap, (n, nx), at `shifted_states` with every input.

        Raises:
            UserError: a case without symmetry.
        """
        symmetry = context.need(context.case.symmetry, "symmetry")
        shape = (symmetry.histories, 1 + symmetry.headings, len(context.input_set), lower.shape[1])
        ends = [own.reshape(shape) for own in (lower, upper)]
        below, above = (np.abs(own[:, 1:] - own[:, :1]).max(axis=(0, 1, 2)) for own in ends)
        return ShiftDeviation(np.maximum(below, above), len(lower), symmetry.along)

    def check(self, states: Sequence[str], tolerance: Mapping[str, float], stops: Sequence[str] = ()) -> None:
        """Hold it against the tolerance of the case; `stops` says which joints X takes to their stops.

        Raises:
            BrokenPromise: naming the state, the deviation and the tolerance.
        """
        for name, value in zip(states, self.largest, strict=True):
            if value > tolerance[name]:
                at_stops = f"; X goes to the stops of {' and '.join(stops)}" if stops else ""
                shrink = "Keep X a step's travel away from the stops, or leave" if stops else "Leave"
                raise BrokenPromise(
                    f"the declared symmetry does not hold: between places along {', '.join(self.along)} the gap in "
                    f"{name} deviates by {value:.3g}, symmetry.tolerance allows {tolerance[name]:.3g}{at_stops}",
                    f"{shrink} the state out of symmetry.along, or raise the tolerance knowingly",
                )

    def tier(self, states: Sequence[str]) -> Tier:
        """What was added to the bound."""
        added = ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, self.largest, strict=True))
        return Tier(
            2,
            f"The gap is taken not to depend on {', '.join(self.along)}. Among {self.samples:,} roll-outs repeated at "
            f"other places along {'it' if len(self.along) == 1 else 'them'}, the ends of X included, the largest "
            f"deviation was {added}; that is added to the bound and is an estimate.",
        )
