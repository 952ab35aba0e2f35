"""What a certificate of a task says beyond that of a target: a formula, its regions, and the automaton of a controller.

The controller moves its automaton on by the letter of the cell that it measures: literals (region, inside or outside)
that are sure there. `sets` verifies that every cell's letter is true of all of it, and that the automaton accepts only
runs that keep the formula.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from expressions import Malformed, exact, well_formed
from formula import Automaton, Formula, read_formula, regions_of
from reach import box_of

MOST_STATES = 10_000


@dataclass
class Task:
    """A task.

    Attributes:
        text: the formula as a person wrote it, and as it is read; tau: the sampling time, s.
        regions: by name the parts whose union a region is: boxes by axis, or expressions, not positive inside.
        automaton: the controller's. letter: (cells,) number of each cell's.
    """

    text: str
    formula: Formula
    tau: Fraction
    regions: dict[str, list[Any]]
    automaton: Automaton
    letter: np.ndarray


def task_of(header: dict[str, Any], letter: np.ndarray, states: list[str], cells: int) -> Task:
    """Read it.

    Raises:
        Malformed: naming what does not fit.
    """
    tau, text, regions = exact(header["sampling_time"]), header["formula"], header["regions"]
    if tau <= 0 or not isinstance(text, str) or not isinstance(regions, dict):
        raise Malformed("a task has a sampling time, a formula and regions by name")
    if not all(said.isprintable() for said in (text, *regions)):
        raise Malformed("no formula and no region has characters that cannot be printed")
    formula, automaton, parts = read_formula(text, tau), _automaton(header["automaton"]), {}
    for name in regions:
        if not isinstance(regions[name], list) or not regions[name]:
            raise Malformed(f"the region {name[:60]!r} is no list of boxes and expressions")
        parts[name] = [_part(one, states) for one in regions[name]]
    named = regions_of(formula) | {name for own in automaton.letters for name, _ in own}
    if not named <= {*regions}:
        raise Malformed(f"it has no region {min(named - {*regions})[:60]!r}")
    if letter.dtype != np.int32 or letter.shape != (cells,):
        raise Malformed("its letters are not one of each cell")
    if letter.min() < 0 or letter.max() >= len(automaton.letters):
        raise Malformed("its cells have letters that its automaton does not know")
    return Task(text, formula, tau, parts, automaton, letter)


def _part(one: Any, states: list[str]) -> Any:
    if isinstance(one, dict):
        return box_of(one, states)
    well_formed(one, {*states})
    return one


def _automaton(given: dict[str, Any]) -> Automaton:
    letters, step, good, done = (given[key] for key in ("letters", "step", "good", "done"))
    states = len(step)
    well = (
        0 < states <= MOST_STATES
        and len(good) == states
        and all(len(row) == len(letters) for row in (*step, *good))
        and all(type(to) is int and -1 <= to < states for row in step for to in row)
        and all(type(own) is bool for row in good for own in row)
        and type(done) is int
        and -1 <= done < states
        and type(given["persists"]) is bool
        and all(isinstance(name, str) and type(inside) is bool for letter in letters for name, inside in letter)
    )
    if not well:
        raise Malformed("its automaton is no table of states and letters")
    literals = [frozenset((name, inside) for name, inside in letter) for letter in letters]
    return Automaton(literals, np.array(step, np.int64), np.array(good, bool), done, given["persists"])
