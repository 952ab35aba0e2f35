"""Single readings that stand alone: what moves cannot jump away for one reading and be back at the next."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.thresholds import MOST_STRAYS, STRAY, STRAY_BESIDE


def strays(residual: Floats, rows: Ints) -> Bools:
    """Readings that miss by far between neighbours that do not, (n, k); none of a channel that has many.

    Args:
        residual: white, of size 1 for a perfect model, (n, k), windows one after another.
        rows: (w + 1,) where windows begin and end; a reading at an end has one neighbour.
    """
    size = np.abs(residual)
    before, after = np.zeros_like(size), np.zeros_like(size)
    before[1:], after[:-1] = size[:-1], size[1:]
    before[rows[:-1]] = 0.0
    after[rows[1:] - 1] = 0.0
    found = (size > STRAY) & (before < STRAY_BESIDE) & (after < STRAY_BESIDE)
    return found & (np.mean(found, axis=0) <= MOST_STRAYS)
