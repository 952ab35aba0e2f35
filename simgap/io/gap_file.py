"""A gap bound from its file: whole, complete, and of the case that asks for it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError, placed
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, GapFunction
from simgap.gap.bounds.load import from_json
from simgap.io.results import read_json
from simgap.plants.context import Context

REMEDY = "Run the gap stage of this case again."


@dataclass(frozen=True, eq=False)
class SavedGap:
    """Content of a `gap.json`.

    Attributes:
        function: the bound.
        swept: lower and upper corners of the box that each input's path stays in, seen from the robot, each (M, 2);
            None for what is no wheeled robot.
        swept_by_class: the same after a previous input of each class, each (C, M, 2); None for one class.
        content: all of the file.
    """

    function: GapFunction
    swept: tuple[Floats, Floats] | None
    content: dict[str, Any]
    swept_by_class: tuple[Floats, Floats] | None = None


def load_gap(path: Path, case: Context) -> SavedGap:
    """Read the bound of a case.

    Raises:
        UserError: a file that is missing, damaged or incomplete, or that belongs to another case.
    """
    content = read_json(path)
    with placed(file=path, remedy=REMEDY):
        function = from_json(content)
        _same(function.domain, case)
        shape = (len(case.input_set), 2)
        count = function.classes.count if isinstance(function, BodyFrameGap) else 1
        by_class = _swept(content, "swept_boxes_by_class", (count, *shape)) if count > 1 else None
        saved = SavedGap(function, _swept(content, "swept_boxes", shape), content, by_class)
    case.own(path, content.get("provenance"), "gap")
    return saved


def _same(found: GapDomain, case: Context) -> None:
    own = GapDomain(tuple(case.states), tuple(case.inputs), case.box, case.input_set, found.free, tuple(case.periodic))
    pairs = {key: (value, own.to_json()[key]) for key, value in found.to_json().items()}
    other = [key for key, (one, wanted) in pairs.items() if json.dumps(one) != json.dumps(wanted)]  # order counts
    if other:
        raise UserError(f"the gap bound is of another case, which differs in {', '.join(other)}")


def _swept(content: dict[str, Any], key: str, shape: tuple[int, ...]) -> tuple[Floats, Floats] | None:
    if key not in content and key == "swept_boxes":
        return None
    try:
        lower, upper = (np.array(content[key][side], dtype=np.float64) for side in ("lower", "upper"))
    except (KeyError, TypeError, ValueError):
        lower = upper = np.empty(0)
    boxes = lower.shape == upper.shape == shape and np.isfinite([lower, upper]).all()
    if not boxes or not (lower <= upper).all():
        raise UserError("its swept boxes are not one finite box for each input", key=key)
    return lower, upper
