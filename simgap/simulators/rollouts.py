"""From a case to its simulator, the engine that it names among the plug-ins, and roll-outs of one sampling time.

Each runs in the engine's own process; those of a wheeled robot are seen from the robot itself.

A simulator with noise is seeded so that every result can be made again. Each step has random numbers of its own: a
roll-out those of its state and input, a run those of its start, and after it one step after the other from the same
stream. So results do not depend on the order of calls or the number of workers. For a range the noise is drawn many
times, and the same draws are taken at every state and input (common random numbers): at each of them they are
independent draws, as the statement about the noise needs it, and from one state to the next the extremes move as fast
as the simulator does. Draws at random for each state would make the extremes of neighbours differ by chance, which no
Lipschitz constant bounds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simgap import plugins
from simgap.arrays import Floats, Ints
from simgap.config.case import Case
from simgap.config.simulator import EngineSection
from simgap.effects import EFFECTS, check_listed, effect
from simgap.errors import UserError
from simgap.plants.model_file import Link
from simgap.simulators.base import Engine, PathSimulator, Simulator
from simgap.simulators.body_samples import REST, BodySamples, joined
from simgap.simulators.supervision import Supervisor, try_as_map


def make_simulator(case: Case, folder: Path) -> Simulator:
    """The simulator that a case declares; call it in the process that will run it.

    Raises:
        UserError: no `simulator` section, a plug-in that is not an engine, or an effect that the engine cannot act out.
    """
    kind, section = engine_of(case, folder), case.simulator
    simulator = kind.build(case, folder)
    if section is None:
        return simulator
    if section.engine in plugins.BUILT_IN["engines"] and not kind.of_a_person:
        return with_noise(simulator, case)
    names, calls = (list(case.plant.states), list(case.plant.inputs)), section.substeps if kind.of_a_person else 1
    Supervisor(simulator, section.engine, names, section.timeout * calls)
    return try_as_map(with_noise(simulator, case), case)


def engine_of(case: Case, folder: Path) -> type[Engine]:
    """The engine that a case names.

    Raises:
        UserError: as `make_simulator`.
    """
    section = case.simulator
    if section is None:
        raise UserError("this stage needs a simulator", key="simulator", remedy="Add `simulator:`.")
    engine = plugins.find("engines", section.engine, folder)
    if not issubclass(engine, Engine):
        raise UserError(
            f"'{section.engine}' is not an engine", key="simulator.engine", remedy="Derive it from simgap's Engine."
        )
    if section.stochastic and not engine.stochastic:
        raise UserError(
            f"the engine '{section.engine}' draws no random numbers of its own", key="simulator.stochastic",
            remedy="Leave it out; simulator.noise adds noise to the inputs and states of any engine.",
        )  # fmt: skip
    check_listed(section.effects, "simulator.effects")
    for k, added in enumerate(section.effects):
        if not engine.acts_out(effect(added.name)):
            known = ", ".join(name for name, kind in EFFECTS.items() if engine.acts_out(kind)) or "none"
            problem = f"the simulator cannot simulate '{added.name}'"
            remedy = f"It supports: {known}. Without it gamma does not cover hardware that has the effect."
            raise UserError(problem, key=f"simulator.effects.{k}.name", remedy=remedy)
    return engine


Range = tuple[Floats, Floats]


def roll_out(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, str]:
    """Successors of states (n, nx) under inputs (n, nu), and the engine's name."""
    with make_simulator(case, folder) as simulator:
        return simulator.rollouts(x, u), simulator.engine


def roll_out_alike(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, str]:
    """`roll_out`, all under the same draw of the noise where there is one: a difference is one of states and inputs."""
    following, spread, engine = roll_out_range(case, folder, x, u, 1)
    return spread[0] if case.is_random and spread is not None else following, engine


def roll_out_range(case: Case, folder: Path, x: Floats, u: Floats, draws: int = 0) -> tuple[Floats, Range | None, str]:
    """`roll_out`, and where late inputs or `draws` of noise spread the successors their range, two (n, nx)."""
    with make_simulator(case, folder) as simulator:
        simulator.draws = draws
        spread = simulator.spread(x, u) if simulator.remembers else None
        return simulator.rollouts(x, u), spread, simulator.engine


def follow(jobs: Sequence[tuple[Case, Sequence[Floats], Sequence[Floats]]], folder: Path) -> list[list[Floats]]:
    """For each case the paths (k + 1, nx) from its starts (nx,) under its inputs (k, nu)."""
    every = []
    for case, starts, inputs in jobs:
        with make_simulator(case, folder) as simulator:
            paths = []
            for start, u in zip(starts, inputs, strict=True):
                simulator.reset(start)
                paths.append(np.stack([start, *(simulator.advance(row) for row in u)]))
            every.append(paths)
    return every


@contextmanager
def open_robot(case: Case, folder: Path) -> Iterator[PathSimulator]:
    """The simulator of a case with hidden state.

    Raises:
        UserError: one that does not record its path.
    """
    with make_simulator(case, folder) as simulator:
        if not isinstance(simulator, PathSimulator):
            problem = "the engine records no poses between samples, which a hidden state needs"
            raise UserError(problem, key="simulator.engine", remedy="Use one that does, such as pybullet_wheeled.")
        yield simulator


def after_previous(case: Case, folder: Path, previous: Floats, inputs: Floats) -> tuple[BodySamples, str]:
    """All inputs (M, nu) after each previous input (P, nu) from rest: (P M) rows, the input running fastest."""
    every = np.arange(len(inputs))
    with open_robot(case, folder) as robot:
        before = [int(np.flatnonzero((inputs == u).all(axis=1))[0]) for u in previous]
        every_path = (robot.responses(u[None], inputs) for u in previous)
        parts = [BodySamples.of_paths(every, p, robot.pose, m) for p, m in zip(every_path, before, strict=True)]
        return joined(parts), robot.engine


def along_sequences(
    case: Case, folder: Path, sequences: Ints, inputs: Floats, seed: int | list[int]
) -> tuple[BodySamples, str]:
    """Every step of random input sequences (n, length), each from rest at a random heading: n length rows."""
    rng = np.random.default_rng(seed)
    with open_robot(case, folder) as robot:
        parts = []
        for numbers in sequences:
            start = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
            paths, before = robot.chain(start, inputs[numbers])[1], np.array([REST, *numbers[:-1]])
            parts.append(BodySamples.of_paths(numbers, paths, robot.pose, before))
        return joined(parts), robot.engine


def last_steps(robot: PathSimulator, sequences: Sequence[Ints], headings: Floats, inputs: Floats) -> BodySamples:
    """The last step of each sequence of input numbers (L,), run from rest at its heading, (n,)."""
    parts = []
    for numbers, heading in zip(sequences, headings, strict=True):
        path = robot.responses(inputs[numbers[:-1]], inputs[numbers[-1:]], float(heading))
        before = int(numbers[-2]) if len(numbers) > 1 else REST
        parts.append(BodySamples.of_paths(numbers[-1:], path, robot.pose, before))
    return joined(parts)


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
