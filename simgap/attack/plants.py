"""Plants that the adversary drives, many runs side by side or one at a time, or the model with its disturbance."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Protocol

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.attack.danger import Danger
from simgap.simulators.base import Simulator
from simgap.specifications.monitor import Monitor

Bounds = Callable[[Floats, Floats, Ints], tuple[Floats, Floats]]
Step = Callable[[Floats, Floats], Floats]


class Plants(Protocol):
    """Some plants, each a run."""

    def reset(self, x: Floats) -> None:
        """Put them at states (n, nx)."""

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """From states (n, nx), where they are, under inputs (n, nu): -> states (n, nx), clearance of the paths (n,).

        `before` (n,) are the numbers of the inputs that acted last, -1 at rest.
        """


class RolledOut:
    """Runs of a simulator whose whole state is x: a step is a roll-out, so runs go side by side."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator

    def reset(self, x: Floats) -> None:
        """Nothing is to be put anywhere; x (n, nx)."""

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (n, nx), (n, nu), (n,)."""
        return self._simulator.rollouts(x, u), None


class OneByOne:
    """One run of a simulator that remembers more than x; its paths are watched where it records them."""

    def __init__(self, simulator: Simulator, monitor: Monitor) -> None:
        self._simulator, self._monitor = simulator, monitor

    def reset(self, x: Floats) -> None:
        """Put the simulator at x, (1, nx)."""
        self._simulator.reset(x[0])

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (1, nx), (1, nu), (1,)."""
        following = self._simulator.advance(u[0])[None]
        path = getattr(self._simulator, "path", None)
        if path is None or not self._monitor.measures_clearance:
            return following, None
        return following, np.array([self._monitor.clearance(path)])


class WorstDisturbance:
    """The model that the controller is made for, `f + [lo, hi]`: the next state is the worst corner of that box.

    What counts as worst is nearness to losing; every fourth time a corner is drawn.
    """

    def __init__(self, step: Step, bounds: Bounds, danger: Danger, monitor: Monitor, rng: np.random.Generator) -> None:
        self._step, self._bounds, self._danger, self._rng = step, bounds, danger, rng
        self._monitor = monitor

    def reset(self, x: Floats) -> None:
        """Nothing is to be put anywhere; x (n, nx)."""

    def advance(self, x: Floats, u: Floats, before: Ints) -> tuple[Floats, Floats | None]:
        """See `Plants`; (n, nx), (n, nu), (n,). Clearance is that of the samples: the box says nothing of the path."""
        predicted, (lo, hi) = self._step(x, u), self._bounds(x, u, before)
        corners = np.stack(
            [predicted + np.where(c, hi, lo) for c in itertools.product((False, True), repeat=x.shape[1])]
        )
        worst = np.argmax(self._danger(corners, self._danger.level is not None), axis=0)
        drawn = self._rng.integers(0, len(corners), len(x))
        taken = np.where(self._rng.integers(0, 4, len(x)) == 0, drawn, worst)
        following = corners[taken, np.arange(len(x))]
        if not self._monitor.measures_clearance:
            return following, None
        return following, np.array([self._monitor.clearance(state[None]) for state in following])
