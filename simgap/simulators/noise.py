"""A simulator with noise: seeded so that every result can be made again, and repeated so that its range is seen.

Each step has random numbers of its own: a roll-out those of its state and input, a run those of its start, and after it
one step after the other from the same stream. So results do not depend on the order of calls or the number of workers.

For a range the noise is drawn many times, and the same draws are taken at every state and input (common random
numbers): at each of them they are independent draws, as the statement about the noise needs it, and from one state to
the next the extremes move as fast as the simulator does, and not as chance does. Draws at random for each state would
make the extremes of neighbours differ by chance, which no Lipschitz constant bounds.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.simulator import EngineSection
from simgap.errors import UserError
from simgap.plants.model_file import Link
from simgap.simulators.base import Simulator

TOGETHER = 65_536
"""Draws that are made at once: what is in memory, and part of what the seed gives."""


def with_noise(simulator: Simulator, case: Case) -> Simulator:
    """The simulator with the noise that its case declares, or as it is.

    Raises:
        UserError: beside delayed or lagged inputs.
    """
    section = case.simulator
    if section is None or not section.is_random:
        return simulator
    if simulator.remembers:
        raise UserError(
            "delayed or lagged inputs are not supported for a simulator with noise", key="simulator.effects",
            remedy="Take them out, or simulator.noise and simulator.stochastic.",
        )  # fmt: skip
    return Noisy(simulator, section, case)


class Noisy(Simulator):
    """A simulator, what it draws, and noise on commands and states: several successors of a state."""

    remembers = True

    def __init__(self, simulator: Simulator, section: EngineSection, case: Case) -> None:
        """Around a simulator whose whole state is x."""
        self.nx, self.nu, self.engine = simulator.nx, simulator.nu, simulator.engine
        self._simulator, self._section = simulator, section
        self._states, self._inputs = list(case.plant.states), list(case.plant.inputs)

    def loaded(self) -> Mapping[str, Link]:
        """Links of the engine."""
        return self._simulator.loaded()

    def close(self) -> None:
        """Release the engine."""
        self._simulator.close()

    def _begin(self, *of: Floats) -> None:
        """The stream of random numbers that belongs to some numbers, or to none."""
        words = np.frombuffer(b"".join(np.asarray(a, dtype=np.float64).tobytes() for a in of), np.uint32)
        self.rng = self._simulator.rng = np.random.default_rng([self._section.noise_seed, *words.tolist()])

    def _drawn(self, names: list[str], count: int) -> Floats:
        """Noise on states or inputs, (count, len(names))."""
        own, none = self._section.noise, np.zeros(count)
        return np.stack([own[n].draw(self.rng, count) if n in own else none for n in names], axis=1)

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,); the noise of a run belongs to where it starts."""
        self._begin(x)
        self._simulator.reset(x)

    def advance(self, u: Floats) -> Floats:
        """Run one sampling time under u (nu,) with its noise: -> (nx,)."""
        following = self._simulator.advance(np.asarray(u, dtype=np.float64) + self._drawn(self._inputs, 1)[0])
        if not self._section.noise.keys().isdisjoint(self._states):
            following = following + self._drawn(self._states, 1)[0]
            self._simulator.reset(following)
        return following

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state, each with noise of its own: (n, nx), (n, nu) -> (n, nx)."""
        out = np.empty((len(x), self.nx))
        for k in range(len(x)):
            self._begin(x[k], u[k])
            out[k] = self._steps(x[k], u[k], 1)[0]
        return out

    def spread(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Least and largest of `draws` successors of each state, the noise the same for all; its own successor if 0."""
        if self.draws == 0:
            return super().spread(x, u)
        lo, hi = np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
        for k in range(len(x)):
            self._begin()
            for first in range(0, self.draws, TOGETHER):
                following = self._steps(x[k], u[k], min(TOGETHER, self.draws - first))
                lo[k], hi[k] = np.minimum(lo[k], following.min(axis=0)), np.maximum(hi[k], following.max(axis=0))
        return lo, hi

    def _steps(self, x: Floats, u: Floats, count: int) -> Floats:
        """Successors of a state (nx,) under an input (nu,) in `count` draws: (count, nx)."""
        commands = u + self._drawn(self._inputs, count) if self.nu else np.zeros((count, 0))
        return self._simulator.rollouts(np.tile(x, (count, 1)), commands) + self._drawn(self._states, count)
