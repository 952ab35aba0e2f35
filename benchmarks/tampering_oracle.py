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
        self.reaches = self.head["kind"] == "reach_avoid"
        wins = self.tables["winning.npy"] == 1
        self.level = self.tables["levels.npy"] if self.reaches else np.where(wins, 0, -1)[:, None]
        self.classes, count = self.level.shape[1], len(self.inputs)
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
        moving = nodes[level[nodes] > 0] if self.reaches else nodes
        if not self.bits[moving].any(axis=1).all():
            return "a promise without an input"
        if (rest := self._places(self._draw(rng, nodes), nodes)) is not None:
            return rest
        row, m = np.nonzero(self.bits[moving])
        return self._steps(Points(self._draw(rng, moving[row]), moving[row], m), rng)

    def _draw(self, rng: np.random.Generator, nodes: NDArray[np.int64]) -> Floats:
        """A point in the cell of each node, near its corners more often than not."""
        index = np.stack(np.unravel_index(nodes // self.classes, tuple(self.cells)), axis=1)
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
        if not self._near(x[ended], self.head["target"], none, True).all():
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
        after = np.where(cell >= 0, self.level[cell, self.of_input[at.m]], -1)
        most = self.level.reshape(-1)[at.node] if self.reaches else 1
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
        table = self.tables["bound.npy"][:, at.node % self.classes, at.m]
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
        swept, keep = self.tables["swept.npy"][:, at.node % self.classes, at.m], self._vector("clearance")
        seen = swept[0] + rng.beta(0.3, 0.3, swept[0].shape) * (swept[1] - swept[0])
        x, pose = at.x + self._turned(at, seen), [self.states.index(s) for s in self.head["pose"][:2]]
        for j in pose:
            slack = keep[j] - SHARE * self.width[j]
            if not self.wraps[j] and ((x[:, j] < self.lo[j] + slack) | (x[:, j] > self.hi[j] - slack)).any():
                return "a path into a wall"
        met = any(self._near(x, box, keep, False).any() for box in self.head["obstacles"])
        return "a path into an obstacle" if met else None
