"""By how much a simulator breaks the symmetry that its robot's gap is declared to have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise
from simgap.gap.bounds.tiers import Tier


@dataclass(frozen=True, eq=False)
class HeadingDeviation:
    """By how much body-frame responses differ between headings.

    Attributes:
        largest: (3,) largest deviation of one heading from heading 0; samples: how many were compared.
    """

    largest: Floats
    samples: int

    def tier(self, states: Sequence[str]) -> Tier:
        """What was added to the bound."""
        added = ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, self.largest, strict=True))
        return Tier(
            2,
            "The gap is taken to depend on position and heading through the robot's own frame alone. The engine keeps "
            f"this symmetry only nearly: among {self.samples:,} roll-outs repeated at random headings the largest "
            f"deviation was {added}; that is added to the bound and is an estimate.",
        )


def heading_deviation(reference: Floats, turned: Floats) -> HeadingDeviation:
    """Compare final body-frame poses at heading 0 (n, 3) with those at other headings (h, n, 3)."""
    off = np.abs(turned - reference[None])
    return HeadingDeviation(off.max(axis=(0, 1)), int(off.shape[0] * off.shape[1]))


def check_symmetry(deviation: HeadingDeviation, states: Sequence[str], tolerance: Mapping[str, float]) -> None:
    """Hold the measured deviation against the tolerance of the case.

    Raises:
        BrokenPromise: naming the state, the deviation and the tolerance.
    """
    for name, value in zip(states, deviation.largest, strict=True):
        if value > tolerance[name]:
            raise BrokenPromise(
                f"the declared symmetry does not hold in the simulator: between headings the gap in {name} deviates "
                f"by {value:.3g}, symmetry.tolerance allows {tolerance[name]:.3g}",
                "Make contacts regular: each wheel a sphere (a cylinder's edge jitters), a caster that slides "
                "(<lateral_friction> 0 to 0.02), more grip, less torque; raise the tolerance knowingly, or remove "
                "`symmetry`",
            )
