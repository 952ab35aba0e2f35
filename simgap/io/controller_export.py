"""A controller as a file for machines without simgap: a C header, or a Python file that needs no package.

Both look a cell up as `Grid.finder` does, with the same operations on doubles in the same order, and hold the input
that the controller's rule picks in each cell. What they promise is what the controller promises, of the measured state
in the units of the case; they say -1 (Python: raise) where it has no input.
"""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.pages import text
from simgap.synthesis.controller import Controller

ENDINGS = (".h", ".py")


def export_controller(controller: Controller, path: Path | str) -> None:
    """Write the controller as a C header (`name.h`) or as Python (`name.py`).

    Raises:
        UserError: another ending, or a file name of which no identifier can be made.
    """
    path = Path(path)
    if path.suffix not in ENDINGS:
        raise UserError("is neither a C header nor Python", file=path, remedy="Let the name end with .h or .py.")
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    if not re.match(r"[A-Za-z]", name):
        raise UserError(
            "does not begin with a letter, but names in it must", file=path, remedy="Give another file name."
        )
    write_text(path, text(f"controller{path.suffix}.j2", **_content(controller, name)))


def _about(c: Controller) -> list[str]:
    made_for = c.metadata.get("case", "a case")
    state = f"x = ({', '.join(c.states)}), as measured, in the units of the case"
    promise = f"Controller of '{made_for}', by simgap, rule {c.rule}. {state}; u = ({', '.join(c.input_names)})."
    lines = wrap(re.sub(r"[^ -~]", "?", promise).replace("*/", "* /").replace('"""', "'''"), 100)
    if c.late:
        lines += ["An input acts one sample after it is chosen: remember it, beginning with FIRST, and give it back."]
    elif c.memory > 1:
        lines += ["The class of the previous input is part of its state: remember it, beginning with FIRST."]
    return lines


def _numbers(values: np.ndarray) -> str:
    """Shortest decimals that read back as the same doubles."""
    return ", ".join(repr(float(v)) for v in np.asarray(values, dtype=np.float64).reshape(-1))


def _table(values: np.ndarray) -> str:
    numbers = [str(v) for v in np.asarray(values).tolist()]
    return ",\n".join(",".join(numbers[k : k + 40]) for k in range(0, len(numbers), 40))


def _content(c: Controller, name: str) -> dict[str, Any]:
    """Values for both templates."""
    kinds, box = np.zeros(len(c.input_set), dtype=np.int64) if c.kind is None else c.kind, c.grid.box
    return {
        "c": c, "name": name, "about": _about(c), "nx": box.size, "nu": c.input_set.shape[1], "m": len(c.input_set),
        "low": _numbers(box.lo), "high": _numbers(box.hi), "width": _numbers(2.0 * c.grid.h),
        "wraps": [j in c.grid.periodic for j in range(box.size)], "inputs": [_numbers(row) for row in c.input_set],
        "kinds": kinds.tolist(), "classes": int(kinds.max()) + 1, "table": _table(c.choice),
    }  # fmt: skip
