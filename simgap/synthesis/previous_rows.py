"""Reach-while-avoid on bit rows where the boxes of a cell also depend on the class of the previous input.

A node is a cell and the class of the input before the present one. Input m takes node (k, c) into the box of (k, m) in
class c and to the class of m, so that what is eroded for m is the set won in the class of m. Every class has its boxes
and its set; the kernels are those of one class (`erosion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.bit_rows import pack_rows, smallest_boxes
from simgap.synthesis.bits import packed_width
from simgap.synthesis.box_erosion import BoxErosion, dilate
from simgap.synthesis.erosion import predecessors, record
from simgap.synthesis.reach_rows import MAX_SHAPE_CELLS, RowSystem
from simgap.synthesis.threads import over_rows

Ints = NDArray[np.int64]
Bits = NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class ClassRows:
    """Row systems of all classes over common erosions.

    Attributes:
        systems: one a class; `shape_of` counts through `groups`, `swept_of` through `swept_shapes`.
        groups: for each class the extents (n, 4) by which its set is eroded.
        swept_shapes: (n, 4) extents of the swept boxes of all classes.
    """

    systems: tuple[RowSystem, ...]
    groups: tuple[Ints, ...]
    swept_shapes: Ints

    @staticmethod
    def of(boxes: Sequence[Abstraction], kind: Ints) -> ClassRows:
        """From one abstraction a class, on the same cells; `kind` (M,) is the class of each input.

        Raises:
            UserError: where no axis allows bit rows, or the boxes differ too much.
        """
        found = [RowSystem.of(a) for a in boxes]
        if any(own is None for own in found):
            raise UserError(
                "classes of the previous input need a gap that does not depend on the position, and boxes of few sizes",
                key="hidden_state.classes",
                remedy="Leave the classes out, or use fewer cells",
            )
        systems = [own for own in found if own is not None]
        extents = [own.shapes[own.shape_of] for own in systems]  # (layers, M, 4)
        of_input = np.broadcast_to(kind[None, :, None], (*extents[0].shape[:2], 1))
        every = np.concatenate([np.concatenate([of_input, e], axis=2).reshape(-1, 5) for e in extents])
        rows, place = np.unique(every, axis=0, return_inverse=True)
        place = place.reshape(len(systems), *extents[0].shape[:2])
        swept = [own.swept_shapes[own.swept_of] for own in systems]
        shapes, where = np.unique(np.concatenate([s.reshape(-1, 4) for s in swept]), axis=0, return_inverse=True)
        where = where.reshape(len(systems), *swept[0].shape[:2])
        if (len(rows) + len(shapes)) * boxes[0].grid.size > MAX_SHAPE_CELLS:
            raise UserError(
                f"{len(rows)} sizes of boxes are too many for {boxes[0].grid.size} cells", key="hidden_state.classes",
                remedy="Use fewer classes or cells.",
            )  # fmt: skip
        made = []
        for own, e, s, shape_of, swept_of in zip(systems, extents, swept, place, where, strict=True):
            keep, number = _worth_trying(own, e, s, of_input)
            made.append(replace(own, keep=keep, number=number, shape_of=shape_of.astype(np.int32), swept_of=swept_of))
        groups = tuple(np.ascontiguousarray(rows[rows[:, 0] == c, 1:]) for c in range(len(boxes)))
        return ClassRows(tuple(made), groups, shapes.astype(np.int64))


def _worth_trying(
    own: RowSystem, extent: Ints, swept: Ints, of_input: Ints
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The inputs that can win a node first: no input of the same class has smaller boxes."""
    parts = [(own.rel, extent), (of_input, np.ones_like(of_input))]
    parts += [(own.swept, swept)] if len(own.swept) else []
    lower, size = (np.concatenate([p[side] for p in parts], axis=2).astype(np.int32) for side in (0, 1))
    keep, number = np.zeros(own.rel.shape[:2], np.int32), np.zeros(len(own.rel), np.int32)
    smallest_boxes(lower, size, keep, number)
    return keep, number


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
        threads: rows are shared among this many threads; the result does not depend on it.
    """
    made, grid, classes = ClassRows.of(boxes, kind), boxes[0].grid, len(boxes)
    s = made.systems[0]
    rows, count = len(s.base), grid.cells[s.bit_axis]
    words, axes = (count + 63) // 64, (s.lengths, s.periodic)
    goal, allowed = np.zeros((rows, words), np.uint64), np.zeros((rows, words), np.uint64)
    pack_rows((target & free).astype(np.uint8), s.base, s.stride, count, goal)
    pack_rows(free.astype(np.uint8), s.base, s.stride, count, allowed)
    won, fresh = np.stack([goal] * classes), np.zeros((classes, rows, words), np.uint64)
    value = np.full((grid.size, classes), -1, np.int32)
    value[target & free] = 0
    mask = np.zeros((grid.size, classes, packed_width(len(kind))), np.uint8)
    clear = np.zeros((len(made.swept_shapes), rows, words), np.uint64)
    BoxErosion(*axes, made.swept_shapes)(allowed, clear, np.zeros(clear.shape[:2], np.uint8))
    ends = np.cumsum([0, *(len(g) for g in made.groups)])
    eroded, grew = np.zeros((ends[-1], rows, words), np.uint64), np.zeros((ends[-1], rows), np.uint8)
    erosions = [BoxErosion(*axes, g) for g in made.groups]
    news, level = np.asarray(goal.any(axis=1), np.uint8), 0
    while news.any():
        level += 1
        for c, erode in enumerate(erosions):
            erode(won[c], eroded[ends[c] : ends[c + 1]], grew[ends[c] : ends[c + 1]], threads)
        for c, own in enumerate(made.systems):
            near = dilate(news, *axes, own.reach[0], own.reach[1])
            sets = (own.layer, own.rel, own.shape_of, eroded, own.swept, own.swept_of, clear)
            trial = (own.keep, own.number, grew, near, won[c], allowed, fresh[c])
            over_rows(partial(predecessors, *axes, *sets, *trial), rows, threads)
            done = (won[c], fresh[c], own.base, own.stride, level, value[:, c], mask[:, c])
            over_rows(partial(record, *axes, *sets, *done), rows, threads)
        news = np.asarray(fresh.any(axis=(0, 2)), np.uint8)
    return ClassReach(value, mask, int(value.max(initial=0)))
