"""An engine behind its commands: a substep at a time where an input is delayed or lags."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.effects import effect
from simgap.effects.commands import InputEffect
from simgap.errors import UserError
from simgap.plants.model_file import Link
from simgap.simulators.base import Simulator
from simgap.simulators.commands import CommandMemory, CommandPath, command_paths


def behind_commands(case: Case, bare: Callable[[Sequence[AddedEffect]], Simulator]) -> Simulator:
    """An engine behind the delayed and lagged commands of a case.

    Args:
        bare: the engine over one substep, on the plant's own states, with these effects.

    Raises:
        UserError: a lagged state of the plant that does not lag in the simulator.
    """
    section, inputs = case.simulator, list(case.plant.inputs)
    assert section is not None
    paths, tau = case_command_paths(case), case.domain.tau if case.domain is not None else 0.0
    lags = check_lagged(case)
    others = tuple(e for e in section.effects if not isinstance(effect(e.name), InputEffect))
    return RememberingInputs(bare(others), paths, [inputs.index(n) for n in lags], tau, section.substeps)


def check_lagged(case: Case) -> list[str]:
    """The inputs whose lag is a state of the case.

    Raises:
        UserError: one that does not lag in the simulator.
    """
    effects = case.simulator.effects if case.simulator is not None else ()
    lags = [s.lag_of for s in case.plant.states.values() if s.lag_of is not None]
    if not set(lags) <= {e.on for e in effects if effect(e.name).memory_state(e.on) is not None}:
        slow = sorted({e.name for e in case.plant.effects if effect(e.name).memory_state(e.on) is not None})
        raise UserError(
            "a lagged input is a state of the plant, but does not lag in the simulator", key="simulator.effects",
            remedy=f"Add {slow} there too, or remove the state.",
        )  # fmt: skip
    return lags


def acts_at_once(case: Case) -> bool:
    """Whether what acts on the plant is constant between samples: no hidden state, nothing that comes late."""
    effects = case.simulator.effects if case.simulator is not None else ()
    return case.hidden_state is None and not any(effect(e.name).remembers for e in effects)


def case_command_paths(case: Case) -> list[CommandPath]:
    """The paths of the commands; the delay that the controller has as its latency is not acted out a second time."""
    if case.domain is None:
        raise UserError("the simulator needs a domain", key="domain", remedy="Add `domain:`.")
    known = case.domain.tau * case.sensing.known_delay if case.sensing else 0.0
    values = {name: case.domain.U[name].list().tolist() for name in case.plant.inputs}
    effects = case.simulator.effects if case.simulator is not None else ()
    return command_paths(effects, values, known)


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
