"""One loop for validation, replay and rigs: a controller and a plant, sample by sample, until a monitor says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.specifications.monitor import Monitor, Run
from simgap.specifications.solution import after_choice


class Plant(Protocol):
    """Plant that the loop drives: a simulator, a rig, the nominal model.

    One that records the path between samples has it as `path` (k, nx) after each step.
    """

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,)."""

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for one sampling time: -> (nx,)."""


class Policy(Protocol):
    """Policy that the loop queries: `synthesis.controller.Controller` is one."""

    @property
    def input_set(self) -> Floats: ...  # noqa: D102
    def lookup(self, x: Floats, pending: Ints | int) -> Ints:
        """Chosen input numbers for measured states (n, nx) and pending inputs: -> (n,), -1 where there is none."""


@dataclass(frozen=True, eq=False)
class Sensing:
    """Knowledge of the controller: bounded measurement error (nx,) and whole samples of latency (0 or 1)."""

    error: Floats
    latency: int = 0

    def measure(self, x: Floats, rng: np.random.Generator) -> Floats:
        """A measurement of x (nx,): corners of the error box as often as its inside, because corners are worst."""
        unit = rng.uniform(-1.0, 1.0, x.shape)
        return x + self.error * (np.sign(unit) if rng.integers(2) else unit)


def closed_loop(
    plant: Plant,
    policy: Policy,
    start: Floats,
    steps: int,
    sensing: Sensing,
    rng: np.random.Generator,
    monitor: Monitor,
    first_measured: Floats | None = None,
) -> Run:
    """Run from `start` (nx,) until `steps` samples, or until the monitor ends it or the controller has no input.

    `first_measured` (nx,) is the first measurement, `start` itself if not given. With one sample of latency the input
    decided from a measurement acts one sample later; until the first one does, the controller's `first` acts. A run
    also ends after a step whose path touches what the monitor watches, where the plant records its path.
    """
    lookup, inputs = scalar_lookup(policy), policy.input_set
    exact = not np.any(sensing.error)
    plant.reset(start)
    x = np.array(start, dtype=np.float64)
    y = x if first_measured is None else first_measured
    pending, kind = int(getattr(policy, "first", 0)), getattr(policy, "kind", None)
    states, measured, applied, known = [x], [y], [], [pending]
    watched = monitor.measures_clearance and getattr(plant, "path", None) is not None
    near = [monitor.clearance(x[None])] if watched else []
    stuck = False
    for _ in range(steps):
        if monitor.over(x, y):
            break
        decided = lookup(y, pending)
        if decided < 0:
            stuck = True
            break
        now, pending = (int(n) for n in after_choice(kind, bool(sensing.latency), pending, decided))
        x = plant.advance(inputs[now])
        y = x if exact else sensing.measure(x, rng)
        states.append(x)
        measured.append(y)
        applied.append(now)
        known.append(pending)
        if watched:
            near.append(monitor.clearance(plant.path))  # type: ignore[attr-defined]
            if near[-1] <= 0.0:
                break
    path, near_path = np.array(states), np.array(near) if watched else None
    measured_path = path if exact else np.array(measured)
    return Run(
        path, np.array(applied, dtype=np.int64), stuck, measured_path, near_path, np.array(known, dtype=np.int64)
    )


def scalar_lookup(policy: Policy) -> Callable[[Floats, int], int]:
    """The policy for one state at a time, (nx,) -> input number; a grid controller answers without array overhead."""
    grid, choice = getattr(policy, "grid", None), getattr(policy, "choice", None)
    if grid is None or choice is None:
        return lambda x, pending: int(policy.lookup(x[None], pending)[0])
    cell_of, memory = grid.finder(), int(getattr(policy, "memory", 1))
    picked = memoryview(choice)  # it answers faster than an array, one element at a time, and copies nothing

    def find(x: Floats, pending: int) -> int:
        cell = cell_of(x)
        return int(picked[cell * memory + pending]) if cell >= 0 else -1

    return find


def batch_loop(
    step: Callable[[Floats, Floats], Floats], policy: Policy, starts: Floats, steps: int, monitor: Monitor
) -> list[Run]:
    """Many runs side by side on a memoryless map `step` (n, nx), (n, nu) -> (n, nx), with exact measurements.

    Each run is the one of `closed_loop`. A map records no path between samples.
    """
    n, nx = starts.shape
    x = np.full((steps + 1, n, nx), np.nan)
    inputs = np.full((steps, n), -1, dtype=np.int64)
    length, stuck = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    x[0] = starts
    alive = np.arange(n)
    first, late = int(getattr(policy, "first", 0)), bool(getattr(policy, "late", False))
    kind = getattr(policy, "kind", None)
    pending = np.full((steps + 1, n), first, dtype=np.int64)
    for k in range(steps):
        alive = alive[~monitor.over_each(x[k, alive], x[k, alive])]
        decided = policy.lookup(x[k, alive], pending[k, alive])
        stuck[alive[decided < 0]] = True
        alive, decided = alive[decided >= 0], decided[decided >= 0]
        if len(alive) == 0:
            break
        now, pending[k + 1, alive] = after_choice(kind, late, pending[k, alive], decided)
        x[k + 1, alive] = step(x[k, alive], policy.input_set[now])
        inputs[k, alive] = now
        length[alive] = k + 1
    paths = [(x[: n + 1, i], inputs[:n, i], pending[: n + 1, i]) for i, n in enumerate(length.tolist())]
    return [Run(path, own, bool(stuck[i]), path, None, known) for i, (path, own, known) in enumerate(paths)]
