"""Closed-loop runs in which the adversary takes every decision that the controller leaves open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.attack.law import Law, Options
from simgap.attack.plants import Plants
from simgap.attack.rules import Scene, choose
from simgap.geometry import Floats
from simgap.specifications.monitor import Run
from simgap.specifications.space import Space

Ints = NDArray[np.int64]


def play(
    plants: Plants,
    law: Law,
    scene: Scene,
    rule: str,
    space: Space,
    starts: Floats,
    steps: int,
    rng: np.random.Generator,
) -> list[Run]:
    """Runs from `starts` (n, nx) of at most `steps` samples, side by side, under one rule.

    A run ends early where the controller has no input at some measurement (it is then `stuck`), and where it may be
    over: at once where every measurement says so, by chance where only some do.
    """
    n, nx = starts.shape
    record = _Record(n, nx, steps, law)
    x, memory = starts.copy(), law.first(n)
    alive, last = np.arange(n), np.full(n, -1)
    plants.reset(starts)
    for k in range(steps):
        options = law.options(space.wrapped(x[alive]), memory[alive])
        going = record.sort_out(k, alive, x[alive], options, rng)
        alive = alive[going]
        if len(alive) == 0:
            break
        own = options.inputs[going]
        acting = law.acting(memory[alive], last[alive])
        m = choose(rule, scene, space.wrapped(x[alive]), acting, last[alive], k, own, rng)
        record.seen[k, alive] = x[alive] + law.corners[options.corner[going][np.arange(len(m)), m]]
        now, memory[alive] = law.applied(memory[alive], m)
        x[alive], near = plants.advance(x[alive], law.inputs[now], last[alive])
        last[alive] = now
        record.add(k, alive, x[alive], now, memory[alive], near)
    return record.runs()


class _Record:
    """States, measurements, inputs and memories of runs side by side."""

    def __init__(self, n: int, nx: int, steps: int, law: Law) -> None:
        self.x, self.seen = np.full((steps + 1, n, nx), np.nan), np.full((steps + 1, n, nx), np.nan)
        self.inputs, self.memory = np.full((steps, n), -1, np.int64), np.tile(law.first(n), (steps + 1, 1))
        self.near, self.watched = np.full((steps + 1, n), np.inf), False
        self.length, self.stuck = np.zeros(n, np.int64), np.zeros(n, np.bool_)
        self._law = law

    def sort_out(self, k: int, alive: Ints, x: Floats, options: Options, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Note sample k of the runs that are alive, (n,) with states x (n, nx); which of them go on: (n,)."""
        self.x[k, alive], self.seen[k, alive] = x, x
        stuck = options.stuck >= 0
        over = ~stuck & (options.ended >= 0)
        over &= ~options.inputs.any(axis=1) | (rng.integers(0, 2, len(alive)) == 0)
        for which, corner in ((stuck, options.stuck), (over, options.ended)):
            self.seen[k, alive[which]] = x[which] + self._law.corners[corner[which]]
        self.stuck[alive[stuck]] = True
        return ~stuck & ~over

    def add(self, k: int, alive: Ints, x: Floats, now: Ints, memory: Ints, near: Floats | None) -> None:
        """Note the step after sample k of these runs, (n,) each, to states x (n, nx)."""
        self.x[k + 1, alive], self.seen[k + 1, alive] = x, x
        self.inputs[k, alive], self.memory[k + 1, alive] = now, memory
        self.length[alive] = k + 1
        if near is not None:
            self.near[k + 1, alive], self.watched = near, True

    def runs(self) -> list[Run]:
        """The runs, one by one."""
        out = []
        for i, n in enumerate(self.length.tolist()):
            near = self.near[: n + 1, i] if self.watched else None
            x, seen, known = self.x[: n + 1, i], self.seen[: n + 1, i], self.memory[: n + 1, i]
            out.append(Run(x, self.inputs[:n, i], bool(self.stuck[i]), seen, near, known))
        return out
