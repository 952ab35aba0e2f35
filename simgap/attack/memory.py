"""What a controller remembers of the input before, and the bound that is then its own."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.gap.bounds.symmetry import BodyFrameGap
from simgap.simulators.body_samples import REST
from simgap.specifications.solution import Solution

__all__ = ["REST", "class_bounds", "stepped"]


def stepped(solution: Solution, memory: Ints, decided: Ints) -> tuple[Ints, Ints]:
    """Which inputs act now, and the memory afterwards: (n,), (n,) -> (n,), (n,)."""
    now, after = solution.step(memory, decided)
    return np.asarray(now, np.int64), np.asarray(after, np.int64)


def class_bounds(gap: BodyFrameGap, m: Ints, before: Ints) -> tuple[Floats, Floats]:
    """Body-frame bounds of steps with input numbers (k,) after others (k,), `REST` among them: two (k, 3)."""
    kind = gap.classes.after(before)
    return gap.class_lower[kind, m], gap.class_upper[kind, m]
