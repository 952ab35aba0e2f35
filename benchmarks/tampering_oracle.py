"""Whether a certificate is false, by points: what the checker proves of sets must hold at every one of them.

It shares no code with `checker/`: cells are looked up in floating point, steps begin at single states, also whole
periods away, with the gap at an end of its bound where the simulator is a black box.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.specifications.formula import parse, regions

WORDS = 60  # of each length that are tried
SHARE = 1e-7  # of a cell: faces that coincide up to rounding are no fault
_FOLDED: dict[str, Callable[[Any, Any], Any]] = {"+": np.add, "*": np.multiply, "min": np.minimum, "max": np.maximum}
_SINGLE: dict[str, Callable[[Any], Any]] = {"sin": np.sin, "cos": np.cos, "abs": np.abs, "/": np.reciprocal}


def value(e: Any, at: Mapping[str, Floats]) -> Any:
    """An expression at points, in floating point."""
    if isinstance(e, str):
        if e in at:
            return at[e]
        parts = e.split("/")
        return float.fromhex(e) if len(parts) == 1 else float(int(parts[0]) / int(parts[1]))
    if isinstance(e, int):
        return float(e)
    if e[0] == "^":
        return value(e[1], at) ** e[2]
    inner = [value(part, at) for part in e[1:]]
    return _SINGLE[e[0]](np.asarray(inner[0], np.float64)) if e[0] in _SINGLE else reduce(_FOLDED[e[0]], inner)


class Task:
    """Formula and automaton of a certificate, tried on words that repeat for ever.

    Attributes:
        step, good: (Q, L); done: -1 for none; letters: literals of each; letter: (cells,).
    """

    def __init__(self, head: dict[str, Any], letter: NDArray[np.int32]) -> None:
        """Read it, and believe it."""
        own, (p, *q) = head["automaton"], head["sampling_time"].split("/")
        tau = int(p) / int(q[0]) if q else float.fromhex(p)
        self.step, self.good = np.array(own["step"]), np.array(own["good"])
        self.done, self.persists, self.letter = own["done"], own["persists"], letter
        self.letters = [{(name, side) for name, side in one} for one in own["letters"]]
        self.formula = parse(head["formula"], lambda bound: int(float(bound.split()[0]) / tau + 1e-9))
        self.names = sorted(regions(self.formula))

    def broken_word(self, rng: np.random.Generator) -> str | None:
        """A word that the automaton accepts and that does not keep the formula."""
        sure = [k for k, own in enumerate(self.letters) if not any((name, not side) in own for name, side in own)]
        for length in (*range(1, 9), *range(10, 60, 10)):
            for _ in range(WORDS):
                read, loop = self._word(rng, sure, length)
                if read is None or not self._accepts(read, loop):
                    continue
                truths = {name: rng.random(len(read)) < 0.5 for name in self.names}
                for at, k in enumerate(read):
                    for name, side in self.letters[k]:
                        truths.get(name, np.zeros(len(read), bool))[at] = side
                if not holds(self.formula, truths, loop)[0]:
                    return "an automaton that accepts what breaks the formula"
        return None

    def _word(self, rng: np.random.Generator, sure: list[int], length: int) -> tuple[list[int] | None, int]:
        """Letters along moves that there are, and where they begin again; any once the task is done."""
        state, read = 0, []
        for _ in range(length):
            open_ones = sure if state == self.done else [k for k in sure if self.step[state, k] >= 0]
            if not open_ones:
                return None, 0
            read.append(open_ones[rng.integers(len(open_ones))])
            state = state if state == self.done else int(self.step[state, read[-1]])
        return read, int(rng.integers(length))

    def _accepts(self, read: list[int], loop: int) -> bool:
        state, at, seen, moves = 0, 0, {}, []
        while (state, at) not in seen:
            if state == self.done:
                return True
            seen[state, at] = len(moves)
            moves.append(bool(self.good[state, read[at]]))
            state, at = int(self.step[state, read[at]]), at + 1 if at + 1 < len(read) else loop
            if state < 0:
                return False
        again = moves[seen[state, at] :]
        return all(again) if self.persists else any(again)


def holds(formula: Any, truths: Mapping[str, NDArray[np.bool_]], loop: int) -> NDArray[np.bool_]:
    """Where a formula in simgap's normal form holds along a word whose end is followed by its position `loop`."""
    count = len(next(iter(truths.values()), np.zeros(0)))
    follow, kind, parts = np.append(np.arange(1, count), loop), formula[0], formula[1:]
    if kind == "in":
        return truths[parts[0]] == parts[1]
    if kind in ("true", "false"):
        return np.full(count, kind == "true")
    own = [holds(part, truths, loop) for part in parts if isinstance(part, tuple)]
    if kind == "X":
        return own[0][follow]
    if kind in ("and", "or"):
        return own[0] & own[1] if kind == "and" else own[0] | own[1]
    left, right = own
    found = right
    for _ in range(2 * count if parts[2] is None else parts[2]):  # one sample more at a time
        more = found[follow]
        found = right | (left & more) if kind == "U" else right & (left | more)
    return found


@dataclass
class Points:
    """States (n, nx) in cells of nodes (n,), unwrapped, and inputs m (n,) that are admitted there."""

    x: Floats
    node: NDArray[np.int64]
    m: NDArray[np.int64]


class Oracle:
    """A certificate as it stands in its folder."""

    def __init__(self, folder: Path) -> None:
        """Read it, and believe it: sums are not looked at."""
        self.head: dict[str, Any] = json.loads((folder / "certificate.json").read_text())
        self.tables = {name: np.load(folder / name) for name in self.head["files"]}
        grid, self.states = self.head["grid"], [s["name"] for s in self.head["states"]]
        self.lo, self.hi = (np.array([float.fromhex(v) for v in grid[end]]) for end in ("lo", "hi"))
        self.cells, self.wraps = np.array(grid["cells"]), np.array(grid["periodic"])
        self.width = (self.hi - self.lo) / self.cells
        self.inputs = np.array([[float.fromhex(v) for v in row] for row in self.head["input_set"]])
        self.reaches = self.head["kind"] != "invariance"
        self.task = Task(self.head, self.tables["letters.npy"]) if self.head["kind"] == "task" else None
        wins = self.tables["winning.npy"] == 1
        self.level = self.tables["levels.npy"] if self.reaches else np.where(wins, 0, -1)[:, None]
        self.memories, count = self.level.shape[1], len(self.inputs)
        self.classes = self.memories // (1 if self.task is None else len(self.task.step))
        of_input = self.head["classes"]["of_input"] if self.reaches else [0] * count
        self.of_input = np.array(of_input)
        self.bits = np.unpackbits(self.tables["inputs.npy"], axis=1, count=count, bitorder="little").astype(bool)

    def refuted(self, rng: np.random.Generator, nodes: NDArray[np.int64]) -> str | None:
        """What is false at some point, in words; None if nothing was found.

        Args:
            rng: draws points. nodes: where they are drawn, (k,).
        """
        level = self.level.reshape(-1)
        nodes = nodes[level[nodes] >= 0]
        if self.task is not None:
            if (rest := self._watched(rng, nodes)) is not None:
                return rest
            moving = nodes[self._read(nodes)[0] != self.task.done]
        else:
            moving = nodes[level[nodes] > 0] if self.reaches else nodes
        if not self.bits[moving].any(axis=1).all():
            return "a promise without an input"
        if (rest := self._places(self._draw(rng, nodes), nodes)) is not None:
            return rest
        row, m = np.nonzero(self.bits[moving])
        return self._steps(Points(self._draw(rng, moving[row]), moving[row], m), rng)

    def _read(self, nodes: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """States of the task after the letters of the nodes' cells, and whether these moves are good."""
        assert self.task is not None
        cells, memory = np.divmod(nodes, self.memories)
        at = memory // self.classes, self.task.letter[cells]
        return self.task.step[at], self.task.good[at]

    def _watched(self, rng: np.random.Generator, nodes: NDArray[np.int64]) -> str | None:
        """Letters at points of the cells, nodes that break the task or get on with it, and words of letters."""
        assert self.task is not None
        state, good = self._read(nodes)
        if (state < 0).any():
            return "a promise where the task is broken"
        at_once = (self.level.reshape(-1)[nodes] == 0) & (state != self.task.done) & ~good
        if at_once.any() and not self.task.persists:
            return "a level 0 without a good move"
        every = np.arange(len(self.task.letter)) * self.memories
        some = np.concatenate([nodes, every[rng.integers(len(every), size=len(nodes) + 1)]])
        x, letter = self._draw(rng, some), self.task.letter[some // self.memories]
        for name, parts in self.head["regions"].items():
            for side in (True, False):
                sure = np.array([(name, side) in own for own in self.task.letters])[letter]
                holds = [self._in_part(x, part, side) for part in parts]
                if (sure & (np.any(holds, axis=0) != side)).any():
                    return "a letter that is not true"
        return self.task.broken_word(rng)

    def _in_part(self, x: Floats, part: Any, generous: bool) -> NDArray[np.bool_]:
        if isinstance(part, dict):
            return self._near(x, part, np.zeros(x.shape[1]), generous)
        names = dict(zip(self.states, x.T, strict=True))
        return np.asarray(np.broadcast_to(value(part, names) <= (1e-9 if generous else -1e-9), len(x)))

    def _draw(self, rng: np.random.Generator, nodes: NDArray[np.int64]) -> Floats:
        """A point in the cell of each node, near its corners more often than not."""
        index = np.stack(np.unravel_index(nodes // self.memories, tuple(self.cells)), axis=1)
        return self.lo + self.width * (index + rng.beta(0.3, 0.3, index.shape))

    def _cell(self, x: Floats) -> NDArray[np.int64]:
        index = np.floor((x - self.lo) / self.width).astype(np.int64)
        index = np.where(self.wraps, index % self.cells, index)
        inside = ((index >= 0) & (index < self.cells)).all(axis=1)
        flat = np.ravel_multi_index(tuple(np.clip(index, 0, self.cells - 1).T), tuple(self.cells))
        return np.where(inside, flat, -1)

    def _near(self, x: Floats, box: Mapping[str, list[str]], keep: Floats, inner: bool) -> NDArray[np.bool_]:
        """Whether points are clearly inside a box that is larger by `keep`; `inner`: or at its faces."""
        good = np.ones(len(x), bool)
        for name, ends in box.items():
            j = self.states.index(name)
            slack = self.width[j] * (SHARE if inner else -SHARE)
            a, b = (float.fromhex(v) for v in ends)
            period = self.hi[j] - self.lo[j]
            turns = period * np.arange(-3, 4) if self.wraps[j] else np.zeros(1)
            at = x[:, j, None] + turns
            good &= ((at > a - keep[j] - slack) & (at < b + keep[j] + slack)).any(axis=1)
        return good

    def _vector(self, key: str) -> Floats:
        return np.array([float.fromhex(self.head[key][s]) for s in self.states])

    def _places(self, x: Floats, nodes: NDArray[np.int64]) -> str | None:
        """Points of winning cells against what is to be avoided, and those at level 0 against the target."""
        none = np.zeros(len(self.states))
        if not self.reaches:
            return None if self._near(x, self.head["safe"], none, True).all() else "a promise outside the safe set"
        ended = self.level.reshape(-1)[nodes] == 0
        if self.task is None and not self._near(x[ended], self.head["target"], none, True).all():
            return "level 0 outside the target"
        keep = self._vector("clearance") + self._vector("between")
        walls = self._vector("clearance") + self._vector("between_walls")
        beyond = (x < self.lo + walls - SHARE * self.width) | (x > self.hi - walls + SHARE * self.width)
        if (beyond & ~self.wraps).any():
            return "a promise in a wall"
        met = any(self._near(x, box, keep, False).any() for box in self.head["obstacles"])
        return "a promise in an obstacle" if met else None

    def _steps(self, at: Points, rng: np.random.Generator) -> str | None:
        turns = rng.integers(-3, 4, at.x.shape) * self.wraps * (self.hi - self.lo)
        real = at.x + turns
        names = {name: self.inputs[at.m, u] for u, name in enumerate(i["name"] for i in self.head["inputs"])}
        here = dict(zip(self.states, at.x.T, strict=True)) | names
        there = dict(zip(self.states, real.T, strict=True)) | names
        step = self._map("nominal", there, len(real))
        if self.head["simulator"] is not None:
            following = self._map("simulator", there, len(real))
            d = self._map("simulator", here, len(real)) - self._map("nominal", here, len(real))
            low, high = self._bound("lower", here, len(real)), self._bound("upper", here, len(real))
            if ((d < low - 1e-12) | (d > high + 1e-12)).any():
                return "a gap outside its bound"
        else:
            following = step + self._gap(at, here, rng)
        cell = self._cell(following)
        most, memory = self.level.reshape(-1)[at.node] if self.reaches else 1, self.of_input[at.m]
        if self.task is not None:
            state, good = self._read(at.node)
            memory = memory + state * self.classes
            most = most + good if self.task.persists else np.where(most == 0, len(self.level) * self.memories, most)
        after = np.where(cell >= 0, self.level[cell, memory], -1)
        if not ((after >= 0) & (after < most)).all():
            return "a step to where nothing is promised"
        return self._paths(at, rng) if "swept.npy" in self.tables else None

    def _map(self, key: str, names: Mapping[str, Floats], count: int) -> Floats:
        return np.stack([np.broadcast_to(value(self.head[key][s], names), count) for s in self.states], axis=1)

    def _bound(self, side: str, names: Mapping[str, Floats], count: int) -> Floats:
        return np.stack([np.broadcast_to(value(self.head["gap"][s][side], names), count) for s in self.states], axis=1)

    def _gap(self, at: Points, here: Mapping[str, Floats], rng: np.random.Generator) -> Floats:
        """A corner of the bound for each step."""
        corner = rng.integers(0, 2, at.x.shape)
        if "bound.npy" not in self.tables:
            return np.where(corner, self._bound("upper", here, len(corner)), self._bound("lower", here, len(corner)))
        table = self.tables["bound.npy"][:, at.node % self.memories % self.classes, at.m]
        return self._turned(at, np.where(corner, table[1], table[0]))

    def _turned(self, at: Points, seen: Floats) -> Floats:
        """Vectors seen from the body as the world sees them; what comes third stays."""
        i, j, k = (self.states.index(s) for s in self.head["pose"])
        c, s, out = np.cos(at.x[:, k]), np.sin(at.x[:, k]), np.zeros_like(at.x)
        along, across = (seen[:, i], seen[:, j]) if seen.shape[1] == 3 else (seen[:, 0], seen[:, 1])
        out[:, i], out[:, j] = along * c - across * s, along * s + across * c
        out[:, k] = seen[:, k] if seen.shape[1] == 3 else 0.0
        return out

    def _paths(self, at: Points, rng: np.random.Generator) -> str | None:
        swept, keep = (
            self.tables["swept.npy"][:, at.node % self.memories % self.classes, at.m],
            self._vector("clearance"),
        )
        seen = swept[0] + rng.beta(0.3, 0.3, swept[0].shape) * (swept[1] - swept[0])
        x, pose = at.x + self._turned(at, seen), [self.states.index(s) for s in self.head["pose"][:2]]
        for j in pose:
            slack = keep[j] - SHARE * self.width[j]
            if not self.wraps[j] and ((x[:, j] < self.lo[j] + slack) | (x[:, j] > self.hi[j] - slack)).any():
                return "a path into a wall"
        met = any(self._near(x, box, keep, False).any() for box in self.head["obstacles"])
        return "a path into an obstacle" if met else None
