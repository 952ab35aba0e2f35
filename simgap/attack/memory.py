"""What a controller remembers of the input before, and the bound that is then its own.

Solutions and bounds that know nothing of the input before are asked as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.gap.function import GapFunction
from simgap.gap.symmetry import BodyFrameGap
from simgap.geometry import Floats
from simgap.specifications.solution import Solution

Ints = NDArray[np.int64]
REST = -1
"""The number of the input before where there was none."""


def stepped(solution: Solution, memory: Ints, decided: Ints) -> tuple[Ints, Ints]:
    """Which inputs act now, and the memory afterwards: (n,), (n,) -> (n,), (n,)."""
    step: Any = getattr(solution, "step", None)
    if step is None:
        return (memory, decided) if solution.late else (decided, np.zeros_like(decided))
    now, after = step(memory, decided)
    return np.asarray(now, np.int64), np.asarray(after, np.int64)


def bounds_after(gap: GapFunction, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats]:
    """lo and hi at points after inputs with these numbers, (n,): (n, nx), (n, nu) -> (n, nx) twice."""
    known: Any = getattr(gap, "bounds_after", None)
    lo, hi = gap.bounds(x, u) if known is None else known(x, u, before)
    return lo, hi


def class_bounds(gap: BodyFrameGap, m: Ints, before: Ints) -> tuple[Floats, Floats]:
    """Body-frame bounds of steps with input numbers (k,) after others (k,), `REST` among them: two (k, 3)."""
    classes: Any = getattr(gap, "classes", None)
    if classes is None:
        return gap.lower[m], gap.upper[m]
    kind, own = classes.after(before), (getattr(gap, f"class_{side}") for side in ("lower", "upper"))
    lo, hi = (values[kind, m] for values in own)
    return lo, hi
