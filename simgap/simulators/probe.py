"""Whether a simulator that is a person's code is a map of x and u: one trial for functions, FMUs and plug-in engines.

The same calls, spread over X and U, are made twice, in another order and after a pause, and again after every larger
block of roll-outs: what differs then depends on what ran before, on chance or on a clock. A second step must be the
step that begins where the first ended: what differs there is state that x does not have. A trial is no proof.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.simulators.base import Simulator

if TYPE_CHECKING:
    from simgap.config.case import Case

CALLS, PAUSE, BLOCK = 16, 0.05, 64
"""How many calls, the pause before they are made again, s, and rows of a block after which they are. A block is
four times as many as the calls; all judgement."""
REMEMBERS = 1e-6
"""Largest relative deviation of a second step from one that begins where the first ended: room for a solver of
variable step. Judgement."""
REMEDY = (
    "Declare what it remembers: as states of the plant (plant.states), or by hidden_state for a robot in the plane. "
    "Fix its seeds."
)


def at_call(names: tuple[Sequence[str], Sequence[str]], x: Any, u: Any) -> str:
    """A call in words: the names of states and inputs with their values, none of x if it is None."""
    pairs = [] if x is None else list(zip(names[0], x, strict=False))
    pairs += list(zip(names[1], u, strict=False))
    return "at " + ", ".join(f"{name} = {float(value):.9g}" for name, value in pairs)


def probed(simulator: Simulator, case: Case) -> Simulator:
    """The same simulator, tried at its first roll-outs, after them.

    Its `rollouts` raise UserError where it answers the same call in two ways, or has more state than the case.
    """
    if case.domain is None:
        return simulator
    own: Any = simulator
    probe, rollouts, tried = _Probe(simulator, case), own.rollouts, [False]

    def rollouts_tried(x: Floats, u: Floats) -> Floats:
        following: Floats = rollouts(x, u)
        if not tried[0]:
            tried[0] = True
            probe.begin(rollouts)
        elif len(x) >= BLOCK:
            probe.repeat(rollouts)
        return following

    own.rollouts = rollouts_tried
    return simulator


class _Probe:
    """Calls spread over X and U, and what was answered first."""

    def __init__(self, simulator: Simulator, case: Case) -> None:
        self._simulator, self._rng = simulator, np.random.default_rng(0)
        self._names = list(case.plant.states), list(case.plant.inputs)
        self._whole = case.hidden_state is None and not simulator.remembers
        domain: Any = case.domain
        lo, hi = np.array([domain.X[name] for name in self._names[0]]).T
        share = np.stack([self._rng.permutation(CALLS) for _ in self._names[0]], axis=1)
        self._x = lo + (hi - lo) * (share + self._rng.random(share.shape)) / CALLS
        values = [self._rng.choice(domain.U[name].list(), CALLS) for name in self._names[1]]
        self._u = np.stack(values, axis=1) if values else np.zeros((CALLS, 0))

    def begin(self, rollouts: Any) -> None:
        self._first = np.array(rollouts(self._x.copy(), self._u.copy()))
        time.sleep(PAUSE)
        self.repeat(rollouts)
        if self._whole:
            self._second_steps()

    def repeat(self, rollouts: Any) -> None:
        order = self._rng.permutation(CALLS)
        again = rollouts(self._x[order], self._u[order])
        for k in np.flatnonzero((again != self._first[order]).any(axis=1))[:1]:
            where = at_call(self._names, self._x[order[k]], self._u[order[k]])
            raise UserError(
                f"the simulator answers the same call in two ways, {where}: it keeps a state, draws random numbers or "
                "reads a clock", key="simulator", remedy=REMEDY,
            )  # fmt: skip

    def _second_steps(self) -> None:
        simulator = self._simulator
        for x, u, other in zip(self._x, self._u, np.roll(self._u, CALLS // 2, axis=0), strict=True):
            simulator.reset(x.copy())
            middle = simulator.advance(u).copy()
            onward = simulator.advance(other).copy()
            simulator.reset(middle.copy())
            off = np.abs(onward - simulator.advance(other)) > REMEMBERS * np.maximum(1.0, np.abs(onward))
            if off.any():
                name = self._names[0][int(np.argmax(off))]
                raise UserError(
                    f"the simulator has more state than the case: a second step moves {name} otherwise than a step "
                    f"that begins where the first ended, {at_call(self._names, x, u)}", key="simulator", remedy=REMEDY,
                )  # fmt: skip
