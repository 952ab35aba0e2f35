"""One loop for validation, replay and rigs: a controller and a plant, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simgap.geometry import Floats

Ints = NDArray[np.int64]


class Plant(Protocol):
    """What the loop drives: a simulator, a rig, the nominal model."""

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for one sampling time: -> (nx,)."""


class Policy(Protocol):
    """What the loop asks: `synthesis.controller.Controller` is one."""

    @property
    def input_set(self) -> Floats: ...  # noqa: D102
    def lookup(self, x: Floats, pending: Ints | int = 0) -> Ints:
        """Chosen input numbers for measured states (n, nx): -> (n,), -1 where there is none."""


@dataclass(frozen=True, eq=False)
class Sensing:
    """What the controller knows: bounded measurement error (nx,) and whole samples of latency (0 or 1)."""

    error: Floats
    latency: int = 0

    def measure(self, x: Floats, rng: np.random.Generator) -> Floats:
        """A measurement of x (nx,): corners of the error box as often as its inside, because corners are worst."""
        unit = rng.uniform(-1.0, 1.0, x.shape)
        return x + self.error * (np.sign(unit) if rng.integers(2) else unit)


@dataclass(frozen=True, eq=False)
class Run:
    """One run: states (k + 1, nx), numbers of the inputs applied (k,), and whether it ran to its end.

    `stuck` says that the controller had no input at the last state.
    """

    x: Floats
    inputs: Ints
    stuck: bool


def closed_loop(
    plant: Plant,
    policy: Policy,
    start: Floats,
    steps: int,
    sensing: Sensing,
    rng: np.random.Generator,
    stop: Callable[[Floats], bool],
    seen: Floats | None = None,
) -> Run:
    """Run from `start` until `steps` samples, a state where `stop` says so, or one without an admissible input.

    `seen` is the first measurement, `start` itself if not given. With one sample of latency the input decided from a
    measurement acts one sample later; the first input is the one that the controller gives at `seen`.
    """
    lookup, inputs = scalar_lookup(policy), policy.input_set
    exact = not np.any(sensing.error)
    plant.reset(start)
    x = np.array(start, dtype=np.float64)
    y = x if seen is None else seen
    pending = lookup(y, getattr(policy, "memory", 1) - 1) if sensing.latency else 0  # "nothing is pending yet"
    states, applied = [x], []
    stuck = pending < 0
    for _ in range(steps):
        if stuck or stop(x):
            break
        decided = lookup(y, pending)
        if decided < 0:
            stuck = True
            break
        now, pending = (pending, decided) if sensing.latency else (decided, 0)
        x = plant.advance(inputs[now])
        y = x if exact else sensing.measure(x, rng)
        states.append(x)
        applied.append(now)
    return Run(np.array(states), np.array(applied, dtype=np.int64), stuck)


def scalar_lookup(policy: Policy) -> Callable[[Floats, int], int]:
    """The policy for one state at a time; a grid controller answers without array overhead."""
    grid, choice = getattr(policy, "grid", None), getattr(policy, "choice", None)
    if grid is None or choice is None:
        return lambda x, pending: int(policy.lookup(x[None], pending)[0])
    lo, hi = grid.box.lo.tolist(), grid.box.hi.tolist()
    width, cells, memory = (2.0 * grid.h).tolist(), list(grid.cells), int(getattr(policy, "memory", 1))
    axes = [(j, lo[j], hi[j], width[j], cells[j], j in grid.periodic) for j in range(len(cells))]
    floor, picked = math.floor, choice.tolist()  # a list answers faster than an array, one element at a time

    def find(x: Floats, pending: int) -> int:
        flat, values = 0, x.tolist()
        for j, low, high, size, count, wraps in axes:  # the same floor as Grid.index: both agree on every bit
            value = values[j]
            k = floor((value - low) / size)
            if k == count and value <= high:
                k -= 1
            if wraps:
                k %= count
            elif not 0 <= k < count:
                return -1
            flat = flat * count + k
        return int(picked[flat * memory + pending])

    return find


def batch_loop(
    step: Callable[[Floats, Floats], Floats],
    policy: Policy,
    starts: Floats,
    steps: int,
    inside: Callable[[Floats], NDArray[np.bool_]],
) -> list[Run]:
    """Many runs side by side on a memoryless map `step` (n, nx), (n, nu) -> (n, nx), with exact measurements.

    A run ends where `inside` is false or the policy has no input. A policy with memory decides one sample ahead, as in
    `closed_loop`.
    """
    n, nx = starts.shape
    x = np.full((steps + 1, n, nx), np.nan)
    inputs = np.full((steps, n), -1, dtype=np.int64)
    length, stuck = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    x[0] = starts
    alive = np.arange(n)
    delayed = int(getattr(policy, "memory", 1)) - 1
    pending = policy.lookup(starts, delayed) if delayed else np.zeros(n, dtype=np.int64)  # "nothing is pending yet"
    stuck |= pending < 0
    alive = alive[~stuck]
    for k in range(steps):
        alive = alive[inside(x[k, alive])]
        decided = policy.lookup(x[k, alive], pending[alive])
        stuck[alive[decided < 0]] = True
        alive, decided = alive[decided >= 0], decided[decided >= 0]
        if len(alive) == 0:
            break
        now = pending[alive] if delayed else decided
        pending[alive] = decided if delayed else 0
        x[k + 1, alive] = step(x[k, alive], policy.input_set[now])
        inputs[k, alive] = now
        length[alive] = k + 1
    return [Run(x[: length[i] + 1, i], inputs[: length[i], i], bool(stuck[i])) for i in range(n)]
