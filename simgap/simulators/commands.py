"""The path of a command to the plant: delayed, changed by static effects, lagged.

An engine holds its input over one engine step. Here that input is the mean over the step of what the plant feels, exact
for the piecewise constant commands that a sampled controller gives.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.effects import AppliedEffect, InputEffect, StaticInputEffect, delays_and_lags, effect
from simgap.effects.commands import DriveEffect
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.plants.model_file import Link
from simgap.simulators.base import Simulator, added_effects, domain_of


def command_after(
    effects: Sequence[AddedEffect], name: str, command: sp.Expr, velocity: sp.Expr | None = None
) -> sp.Expr:
    """Command after the static effects on an input, or, at a velocity, drive after the effects of the drive.

    They act in the order of their ranks, the last nearest the command.
    """
    own = [e for e in sorted(effects, key=lambda e: effect(e.name).rank) if e.on == name]
    for added in reversed(own):
        kind, values = effect(added.name), {key: sp.Float(value) for key, value in added.parameters.items()}
        if velocity is None and isinstance(kind, StaticInputEffect):
            kind.check_values(added.parameters)
            command = kind.applied(command, values)
        elif velocity is not None and isinstance(kind, DriveEffect):
            command = kind.felt(command, velocity, values)
    return command


@dataclass(frozen=True)
class CommandPath:
    """One input's path to the plant.

    Attributes:
        delay: s; lag: time constant, s, 0 for none.
        static: what the static effects make of a command.
        values: ascending, what the input may be.
    """

    delay: float
    lag: float
    static: Callable[[float], float]
    values: tuple[float, ...]

    @staticmethod
    def of(effects: Sequence[AddedEffect], name: str, values: Sequence[float], known_delay: float) -> CommandPath:
        """From the effects on one input; `known_delay` (s) of it is the controller's latency and not the plant's."""
        own = delays_and_lags(AppliedEffect(e.name, e.on, e.parameters) for e in effects if e.on == name)
        delay, lag = own.get(name, (0.0, 0.0))
        command = symbol("command")
        static = sp.lambdify([command], command_after(effects, name, command), modules="math")
        return CommandPath(max(0.0, delay - known_delay), lag, static, tuple(sorted(values)))

    @property
    def felt(self) -> tuple[float, float]:
        """Least and largest of what the plant can feel."""
        reached = [self.static(v) for v in self.values]
        return min(reached), max(reached)


@dataclass
class CommandMemory:
    """Memory of one path: commands still under way, and the output of the lag.

    Attributes:
        past: earlier commands, the latest last; as many as can still matter.
        output: of the lag.
    """

    path: CommandPath
    tau: float
    past: list[float] = field(default_factory=list)
    output: float = 0.0

    @property
    def depth(self) -> int:
        """Number of earlier commands that can still matter."""
        return math.ceil(self.path.delay / self.tau * (1.0 - 1e-12))

    def rest(self, command: float) -> None:
        """Remember this as commanded for ever."""
        self.past, self.output = [command] * self.depth, self.path.static(command)

    def hold(self, which: int) -> None:
        """Remember the least (0) or the largest (1) that the plant can feel as commanded for ever."""
        self.rest((max if which else min)(self.path.values, key=self.path.static))

    def draw(self, rng: np.random.Generator) -> None:
        """Random admissible commands; the lag's output anywhere in its range, its ends as often as its inside."""
        low, high = self.path.felt
        self.past = [float(v) for v in rng.choice(self.path.values, self.depth)]
        share = rng.uniform() if rng.integers(2) else float(rng.integers(2))
        self.output = low + share * (high - low)

    def step(self, command: float, steps: int) -> Floats:
        """Hold a command for tau: -> what the plant feels, its mean over each of `steps` engine steps, (steps,)."""
        h, depth = self.tau / steps, self.depth
        sent = [*self.past, command]
        late, early = (self.path.static(sent[k]) for k in (0, min(1, depth)))
        switch = self.path.delay - (depth - 1) * self.tau if depth else 0.0  # `late` is felt until then
        felt = np.empty(steps)
        for k in range(steps):
            first = min(max(switch - k * h, 0.0), h)
            felt[k] = (self._piece(late, first) + self._piece(early, h - first)) / h
        self.past = sent[len(sent) - depth :]
        return felt

    def _piece(self, drive: float, dt: float) -> float:
        """Integral of what is felt over dt seconds under a constant drive; the lag's output moves on."""
        if dt == 0.0 or self.path.lag == 0.0:
            return drive * dt
        ratio = -math.expm1(-dt / self.path.lag)
        off = self.output - drive
        self.output = drive + off * (1.0 - ratio)
        return drive * dt + off * self.path.lag * ratio


def acts_at_once(case: Case) -> bool:
    """True if what acts on the plant is constant between samples: no hidden state, nothing that comes late."""
    return case.hidden_state is None and not any(effect(e.name).remembers for e in added_effects(case))


def with_commands(case: Case, bare: Callable[[Sequence[AddedEffect]], Simulator]) -> Simulator:
    """An engine behind the delayed and lagged commands of a case.

    Args:
        bare: the engine over one substep, on the plant's own states, with these effects.

    Raises:
        UserError: a lagged state of the plant that does not lag in the simulator.
    """
    section, inputs = case.simulator, list(case.plant.inputs)
    assert section is not None
    paths, lags = case_command_paths(case), [inputs.index(n) for n in check_lagged(case)]
    others = tuple(e for e in section.effects if not isinstance(effect(e.name), InputEffect))
    return RememberingInputs(bare(others), paths, lags, domain_of(case).tau, section.substeps)


def check_lagged(case: Case) -> list[str]:
    """The inputs whose lag is a state of the case.

    Raises:
        UserError: one that does not lag in the simulator.
    """
    lags = [s.lag_of for s in case.plant.states.values() if s.lag_of is not None]
    if not set(lags) <= {e.on for e in added_effects(case) if effect(e.name).memory_state(e.on) is not None}:
        slow = sorted({e.name for e in case.plant.effects if effect(e.name).memory_state(e.on) is not None})
        problem = "a lagged input is a state of the plant, but does not lag in the simulator"
        raise UserError(problem, key="simulator.effects", remedy=f"Add {slow} there too, or remove the state.")
    return lags


def case_command_paths(case: Case) -> list[CommandPath]:
    """The path of each input; the delay that the controller has as its latency is not acted out a second time.

    Raises:
        UserError: an effect on an input that the plant does not have.
    """
    domain, effects, inputs = domain_of(case), added_effects(case), case.plant.inputs
    for k, e in enumerate(effects):
        if isinstance(effect(e.name), InputEffect) and e.on not in inputs:
            raise UserError(
                f"'{e.on}' is not an input", key=f"simulator.effects.{k}.on", remedy=f"Inputs: {', '.join(inputs)}."
            )
    known = domain.tau * case.sensing.known_delay if case.sensing else 0.0
    return [CommandPath.of(effects, name, domain.U[name].list().tolist(), known) for name in inputs]


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
        """Links of the engine."""
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
