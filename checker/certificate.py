"""A certificate as it is read: nothing in it is believed but what `check` verifies."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from math import inf, prod
from pathlib import Path
from typing import Any

import numpy as np
from expressions import Malformed, exact, interval, well_formed
from reach import OWN, TASK, Reach, classes_of, reach_of, reach_tables
from task import Task, task_of

FORMAT, VERSION = "simgap certificate", 1
LARGEST_HEADER = 2**26  # bytes of certificate.json
INVARIANCE, REACH = "invariance", "reach_avoid"


@dataclass
class Certificate:
    """Grid and tables, the map and its bound.

    A node is a cell and a memory: state of the task * classes + class of the previous input. Where nothing is
    remembered there is one.

    Attributes:
        lo, hi: exact ends of the grid by state; cells: per axis; periodic: flags.
        inputs: exact values, (M, nu). admissible: (nodes, M) as packed bits, bit m % 8 of byte m // 8.
        winning: (cells,) bool, the cells that are promised. level: (cells, memories), -1 where losing; 0 in the
            target, or where an invariance wins; of a task the largest number of steps until its next good move.
        of_input: (M,) class of each input. reach: what kinds with obstacles say, None for an invariance.
        task: what a task says, None for the other kinds.
        header: everything in certificate.json.
    """

    header: dict[str, Any]
    states: list[str]
    input_names: list[str]
    lo: list[Fraction]
    hi: list[Fraction]
    cells: list[int]
    periodic: list[bool]
    inputs: list[list[Fraction]]
    admissible: np.ndarray
    winning: np.ndarray
    level: np.ndarray
    of_input: np.ndarray
    reach: Reach | None = None
    task: Task | None = None

    @property
    def size(self) -> int:
        """Number of cells."""
        return prod(self.cells)

    @property
    def memories(self) -> int:
        """Number of memories."""
        return int(self.level.shape[1])

    @property
    def classes(self) -> int:
        """Number of classes of the previous input."""
        return self.memories if self.task is None else self.memories // len(self.task.automaton.step)

    def parts(self, nodes):
        """Cells, states of the task and classes of nodes, numbers or arrays."""
        cells, memory = np.divmod(nodes, self.memories)
        return cells, *np.divmod(memory, self.classes)

    def moves(self, nodes):
        """States of the task after the letters of the nodes' cells, -1 where it is broken, and whether moves are good.

        None but for a task.
        """
        cells, states, _ = self.parts(nodes)
        at = states, self.task.letter[cells]
        return self.task.automaton.step[at], self.task.automaton.good[at]

    def after(self, nodes, ms):
        """Memories after inputs in nodes."""
        return self.of_input[ms] + (0 if self.task is None else self.moves(nodes)[0] * self.classes)

    def ended(self, nodes) -> np.ndarray:
        """Nodes in which a run ends, if they win: in the target, or with the task done. (n,) bool."""
        if self.task is not None:
            return (self.task.automaton.done >= 0) & (self.moves(nodes)[0] == self.task.automaton.done)
        return self.level.reshape(-1)[nodes] == 0 if self.reach is not None else np.zeros(len(nodes), bool)

    def below(self, nodes):
        """Successors win at a level less than this.

        That is the level of the node, which falls with every step until the target or the next good move. After a good
        move anything wins; or, where moves are to be good in the end, the level after it is no higher.
        """
        if self.reach is None:
            return np.ones_like(nodes)
        level = self.level.reshape(-1)[nodes].astype(np.int64)
        if self.task is None:
            return level
        return level + self.moves(nodes)[1] if self.task.automaton.persists else np.where(level == 0, 2**32, level)

    def admits(self, m: int) -> np.ndarray:
        """Nodes in which input m is admissible, (nodes,) bool."""
        return ((self.admissible[:, m // 8] >> (m % 8)) & 1).astype(bool)

    def index(self, cell: int) -> tuple[int, ...]:
        """Index of a cell along each axis."""
        return tuple(int(k) for k in np.unravel_index(cell, self.cells))


def read(folder: Path) -> Certificate:
    """Read a certificate.

    Raises:
        Malformed: what is missing, damaged or not of this format.
    """
    try:
        header = json.loads(_regular(folder / "certificate.json", LARGEST_HEADER).read_text())
        if (header["format"], header["version"]) != (FORMAT, VERSION):
            raise Malformed("it is no certificate of this format and version")
        if header["kind"] not in (INVARIANCE, REACH, TASK):
            raise Malformed(f"it is of the kind {str(header['kind'])[:60]!r}, which this checker does not know")
        names = ("inputs.npy", "winning.npy") if header["kind"] == INVARIANCE else reach_tables(header)
        tables = {name: _table(folder / name, header["files"][name]) for name in names}
        if header["digest"] != digest_of(header):
            raise Malformed("its header was changed: the digest does not fit")
        return _certificate(header, tables)
    except KeyError as error:
        raise Malformed(f"its header has no {error}") from None
    except (OSError, EOFError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise Malformed(f"it cannot be read: {error!r:.150}") from None


def digest_of(header: dict[str, Any]) -> str:
    """SHA-256 of the header without this key, as compact JSON with sorted keys."""
    rest = {key: value for key, value in header.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _regular(path: Path, most: float = inf) -> Path:
    """The path of a file that has a size: a pipe keeps its reader waiting, and a device never ends."""
    if path.exists() and not (path.is_file() and 0 < path.stat().st_size <= most):
        raise Malformed(f"{path.name} is no regular file, is empty, or is larger than such a file can be")
    return path


def _table(path: Path, digest: str) -> np.ndarray:
    """An array that stays on disk: a robot's table of inputs is a gigabyte."""
    with _regular(path).open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    if found != digest:
        raise Malformed(f"{path.name} was changed: its SHA-256 is not that of the header")
    return np.load(path, mmap_mode="r", allow_pickle=False)


def _certificate(header: dict[str, Any], tables: dict[str, np.ndarray]) -> Certificate:
    grid, cells = header["grid"], header["grid"]["cells"]
    inputs = [[exact(v) for v in row] for row in header["input_set"]]
    states, names = [s["name"] for s in header["states"]], [i["name"] for i in header["inputs"]]
    lo, hi = [exact(v) for v in grid["lo"]], [exact(v) for v in grid["hi"]]
    _check_header(header, states, names)
    admissible, winning = tables["inputs.npy"], tables["winning.npy"]
    good = (
        len(states) == len(lo) == len(hi) == len(cells) == len(grid["periodic"])
        and all(a < b for a, b in zip(lo, hi, strict=True))
        and all(type(k) is int and k > 0 for k in cells)
        and all(type(wraps) is bool for wraps in grid["periodic"])
        and len(inputs) > 0
        and all(len(row) == len(names) for row in inputs)
        and admissible.dtype == winning.dtype == np.uint8
        and winning.shape == (prod(cells),)
    )
    if not good:
        raise Malformed("its tables do not fit its grid and its inputs")
    wins, reach, task, of_input = winning == 1, None, None, np.zeros(len(inputs), np.int64)
    level = np.where(wins, 0, -1).astype(np.int32)[:, None]
    if header["kind"] != INVARIANCE:
        of_input, classes = classes_of(header, len(inputs))
        if header["kind"] == TASK:
            task = task_of(header, tables["letters.npy"], states, prod(cells))
        memories = classes if task is None else classes * len(task.automaton.step)
        level = tables["levels.npy"]
        if level.dtype != np.int32 or level.shape != (prod(cells), memories) or level.min() < -1:
            raise Malformed("its levels do not fit its grid and its memories")
        reach = reach_of(header, tables, states, (classes, len(inputs)))
    if admissible.shape != (level.size, (len(inputs) + 7) // 8):
        raise Malformed("its tables do not fit its grid and its inputs")
    about = (states, names, lo, hi, cells, grid["periodic"], inputs, admissible, wins, level, of_input, reach, task)
    return Certificate(header, *about)


def _check_header(header: dict[str, Any], states: list[str], inputs: list[str]) -> None:
    """Everything that is looked up later is there and well formed.

    Raises:
        KeyError, ValueError, TypeError: what is missing. Malformed: what is no name, number or expression.
    """
    names = set(states + inputs)
    if not states or len(names) < len(states + inputs) or not all(isinstance(name, str) for name in names):
        raise Malformed("its states and inputs need a name each, and no two the same")
    if any(name.startswith(OWN) or not name.isprintable() for name in names):
        raise Malformed(f"no name begins with {OWN!r} or has characters that cannot be printed")
    said = header["not_covered"]
    if not isinstance(said, list) or not all(isinstance(text, str) for text in said):
        raise Malformed("its 'not_covered' is no list of sentences")
    reaches = header["kind"] != INVARIANCE
    expressions = [header["nominal"], *([] if header["simulator"] is None else [header["simulator"]])]
    in_frame = reaches and header["gap"] is None
    if in_frame and header["simulator"] is not None:
        raise Malformed("a bound in a body's frame and a simulator in closed form do not go together")
    for s in states:
        for ends in (header["domain"][s],) if reaches else (header["domain"][s], header["safe"][s]):
            interval(ends, s)
        sides = () if in_frame else (header["gap"][s]["lower"], header["gap"][s]["upper"])
        for e in (*(known[s] for known in expressions), *sides):
            well_formed(e, names)
