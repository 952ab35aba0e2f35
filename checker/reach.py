"""What a certificate of reach-while-avoid says beyond that of an invariance: target, obstacles, memory, body frame.

That of a task has all of it but the target.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from expressions import Malformed, exact, interval

TASK = "task"
OWN = "*"  # begins the names that the checker gives to numbers of its tables
Ends = dict[int, tuple[Fraction, Fraction]]


@dataclass
class Reach:
    """Everything by axis number.

    Attributes:
        target: the box to reach, None for a task. obstacles: boxes to avoid; both by the axes that they bound.
        clearance: what to keep from obstacles and walls; between: by how much a path may stray from its samples where
            no swept boxes are given; walls: the same beyond the walls of a box that holds them, which may be less.
        at_rest: class in which a run starts.
        pose: axes of x, y and heading of a body in the plane, or None.
        bound: (2, classes, M, 3) lower and upper ends of the gap in the body's frame, by state; None where the header
            has expressions.
        swept: (2, classes, M, 2) box in the body's frame, along x and y, in which the whole path of a step lies; None.
    """

    target: Ends | None
    obstacles: list[Ends]
    clearance: list[Fraction]
    between: list[Fraction]
    walls: list[Fraction]
    at_rest: int
    pose: tuple[int, int, int] | None
    bound: np.ndarray | None
    swept: np.ndarray | None

    @property
    def keep(self) -> list[Fraction]:
        """How far samples keep from obstacles, by axis."""
        return [a + b for a, b in zip(self.clearance, self.between, strict=True)]

    @property
    def keep_from_walls(self) -> list[Fraction]:
        """How far samples keep from walls, by axis."""
        return [a + b for a, b in zip(self.clearance, self.walls, strict=True)]


def reach_tables(header: dict[str, Any]) -> tuple[str, ...]:
    """Tables that such a certificate needs."""
    more = [name for name in ("bound.npy", "swept.npy") if name in header["files"]]
    own = ("letters.npy",) if header["kind"] == TASK else ()
    return ("inputs.npy", "winning.npy", "levels.npy", *own, *more)


def classes_of(header: dict[str, Any], inputs: int) -> tuple[np.ndarray, int]:
    """Class of each input and how many there are.

    Raises:
        Malformed: what numbers no classes.
    """
    of_input, rest = header["classes"]["of_input"], header["classes"]["at_rest"]
    good = isinstance(of_input, list) and len(of_input) == inputs and all(type(c) is int and c >= 0 for c in of_input)
    if not good or {*of_input} != {*range(max(of_input) + 1)} or type(rest) is not int or rest not in of_input:
        raise Malformed("its classes of the previous input are not numbered from 0")
    return np.array(of_input, dtype=np.int64), max(of_input) + 1


def reach_of(header: dict[str, Any], tables: dict[str, Any], states: list[str], shape: tuple[int, int]) -> Reach:
    """Read it; `shape` is (classes, M).

    Raises:
        Malformed: naming what does not fit.
    """
    pose, bound, swept = header["pose"], tables.get("bound.npy"), tables.get("swept.npy")
    if pose is not None and (not isinstance(pose, list) or sorted(pose) != sorted(states) or len(pose) != 3):
        raise Malformed("a pose is the names of the three states, x, y and heading")
    if (header["gap"] is None) != (bound is not None) or (pose is None and (bound is not None or swept is not None)):
        raise Malformed("its gap is either expressions, or a table in the frame of a pose")
    if bound is None and shape[0] > 1:
        raise Malformed("classes of the previous input need a bound for each, in a table")
    for name, table, width in (("bound", bound, 3), ("swept", swept, 2)):
        if table is not None and not _ordered(table, (2, *shape, width)):
            raise Malformed(f"its table {name}.npy is not one finite box for each class and input")
    if not isinstance(header["obstacles"], list):
        raise Malformed("its obstacles are no list")
    clearance, between = ([exact(header[key][s]) for s in states] for key in ("clearance", "between"))
    walls = [exact(header["between_walls"][s]) for s in states] if "between_walls" in header else between
    if any(v < 0 for v in clearance + between + walls):
        raise Malformed("a clearance is not negative")
    return Reach(
        None if header["kind"] == TASK else box_of(header["target"], states),
        [box_of(one, states) for one in header["obstacles"]],
        clearance,
        between,
        walls,
        header["classes"]["at_rest"],
        None if pose is None else (states.index(pose[0]), states.index(pose[1]), states.index(pose[2])),
        bound,
        swept,
    )


def _ordered(table: np.ndarray, shape: tuple[int, ...]) -> bool:
    good = table.dtype == np.float64 and table.shape == shape and bool(np.isfinite(table).all())
    return good and bool((table[0] <= table[1]).all())


def box_of(named: Any, states: list[str]) -> Ends:
    """A box by the axes that it bounds.

    Raises:
        Malformed: what bounds none of the states, or something else.
    """
    if not isinstance(named, dict) or not named or not {*named} <= {*states}:
        raise Malformed("a target, an obstacle and a region bound some of the states")
    return {states.index(s): interval(ends, s) for s, ends in named.items()}
