"""Reach-while-avoid where the boxes of a cell also depend on the class of the previous input (`reach_rows`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.reach_rows import RowSystem, reach_by_rows, with_common_sweeps

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ClassReach:
    """What the fixed point found.

    Attributes:
        value: (cells, classes) int32 worst-case steps to the target, -1 where losing.
        mask: (cells, classes, ceil(M / 8)) uint8 admissible inputs, none in the target.
        steps: the largest value.
    """

    value: NDArray[np.int32]
    mask: NDArray[np.uint8]
    steps: int


def reach_by_classes(
    boxes: Sequence[Abstraction], kind: Ints, target: NDArray[np.bool_], free: NDArray[np.bool_], threads: int = 1
) -> ClassReach:
    """Nodes from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        boxes: one abstraction a class of the previous input, on the same cells and inputs.
        kind: (M,) class of each input.
        target, free: (cells,); target cells that are not free do not count.
        threads: slabs are shared among this many threads; the result does not depend on it.

    Raises:
        UserError: where no axis allows bit rows, or there are too many boxes.
    """
    found = [RowSystem.of(a) for a in boxes]
    systems = [own for own in found if own is not None]
    if len(systems) < len(found):
        raise UserError(
            "classes of the previous input need a gap that does not depend on the position, and boxes of few sizes",
            key="hidden_state.classes",
            remedy="Leave the classes out, or use fewer cells",
        )
    value, mask, _ = reach_by_rows(with_common_sweeps(systems), kind, target, free, threads, masks=True)
    return ClassReach(value, mask, int(value.max(initial=0)))
