"""A simulator whose inputs remember: delay and lag between the command and an engine that has neither.

The state of the plant is then not all that decides its next state. A reset draws what earlier commands left behind from
what admissible commands can leave (the same for the same state, so that roll-outs do not depend on their order), and
`spread` gives the least and largest successor over the extremes of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from simgap.geometry import Floats
from simgap.plants.model_file import Link
from simgap.simulators.base import Simulator
from simgap.simulators.commands import CommandMemory, CommandPath


class RememberingInputs(Simulator):
    """An engine behind delayed and lagged commands.

    Args:
        engine: advances one engine step at a call, on the plant's own states.
        paths: of each input.
        lags: for each lag whose output is a state of the case, the number of its input; these states come last.
        tau: sampling time, s.
        steps: engine steps within tau.
    """

    remembers = True

    def __init__(
        self, engine: Simulator, paths: Sequence[CommandPath], lags: Sequence[int], tau: float, steps: int
    ) -> None:
        self.nx, self.nu = engine.nx + len(lags), engine.nu
        self.engine = engine.engine
        self._engine, self._lags, self._steps = engine, tuple(lags), steps
        self._memory = [CommandMemory(path, tau) for path in paths]

    def loaded(self) -> Mapping[str, Link]:
        """Those of the engine."""
        return self._engine.loaded()

    def reset(self, x: Floats) -> None:
        """Put the plant at x (nx,); what the inputs remember is random, and the same whenever x is the same."""
        rng = np.random.default_rng(np.frombuffer(np.ascontiguousarray(x, dtype=np.float64).tobytes(), np.uint32))
        for memory in self._memory:
            memory.draw(rng)
        self._place(x)

    def _place(self, x: Floats) -> None:
        self._engine.reset(x[: self._engine.nx])
        for k, j in enumerate(self._lags):
            self._memory[j].output = float(x[self._engine.nx + k])

    def advance(self, u: Floats) -> Floats:
        """Command u (nu,) for one sampling time: -> the new state (nx,)."""
        felt = np.stack([m.step(float(c), self._steps) for m, c in zip(self._memory, u, strict=True)], axis=1)
        for row in felt:
            following = self._engine.advance(row)
        return np.concatenate([following, [self._memory[j].output for j in self._lags]])

    def spread(self, x: Floats, u: Floats) -> tuple[Floats, Floats]:
        """Hull of the successors over the extremes of every input's memory: (n, nx), (n, nu) -> two (n, nx)."""
        lo, hi = np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
        for corner in itertools.product((0, 1), repeat=self.nu):
            for n in range(len(x)):
                for memory, which in zip(self._memory, corner, strict=True):
                    memory.hold(which)
                self._place(x[n])
                following = self.advance(u[n])
                lo[n], hi[n] = np.minimum(lo[n], following), np.maximum(hi[n], following)
        return lo, hi

    def close(self) -> None:
        """Release the engine."""
        self._engine.close()
