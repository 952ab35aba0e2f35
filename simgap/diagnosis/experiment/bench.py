"""A plant on which nobody has experimented yet: rival explanations moved by one input, and how far they would part.

If rival A is right, the recording to come holds what A predicts and noise. What B would miss of it, its parameters
fitted again to all recordings and the initial state of each window free, is

    D(A, B) = min over d of |y_A - y_B - J_B d|^2 / sigma^2 + d^T G_B d,

J_B the sensitivities of B with the initial states projected out and G_B what the recordings at hand say of its
parameters. D / 2 is the expected logarithm of the likelihood ratio. Source: Atkinson, Fedorov (1975), Biometrika 62(1)
(T-optimality), here linearised in B's parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.noise import weights
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.sensitivity import linearise, slot_direction
from simgap.diagnosis.simulation.supermodel import SuperModel
from simgap.diagnosis.thresholds import BIC_GAIN
from simgap.geometry import Box


@dataclass(frozen=True, eq=False)
class Rival:
    """An explanation, fitted to the recordings at hand.

    Attributes:
        label: what people read; theta: all parameters; slots: the free ones, with difference steps.
        count: number of parameters, discrete choices included.
        information: (p, p) of the free ones, from the recordings at hand.
    """

    label: str
    theta: Floats
    slots: tuple[int, ...]
    steps: tuple[float, ...]
    count: int
    information: Floats


@dataclass(frozen=True, eq=False)
class Bench:
    """Where the next recording is made.

    Attributes:
        model: with the effects of all rivals; sigma: (k,) noise of the measured states.
        t: (n,) s; windows: of them, as the fit will cut them; tells: (w,) which it looks at; h_max: longest step, s.
        start: (nx,) state at the first sample; allowed: states that the plant may come to.
        middle, reach: (m,) of the inputs, or of those that are no known condition.
        held: values of the known conditions, after the inputs.
        excess: chi^2/dof that the best explanation leaves, at least 1; counted: numbers in the recordings at hand.
        steps, shared: (k,) counts of encoders, and what of the noise the readings of one count have in common.
    """

    model: SuperModel
    sigma: Floats
    t: Floats
    windows: Windows
    tells: Bools
    h_max: float
    start: Floats
    allowed: Box
    middle: Floats
    reach: Floats
    held: tuple[float, ...] = ()
    excess: float = 1.0
    counted: int = 0
    steps: Floats = field(default_factory=lambda: np.zeros(0))
    shared: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def compared(self) -> int:
        """How many numbers of the recording to come are compared."""
        return self.windows.pick(self.tells).samples * len(self.sigma)

    def input(self, wave: Floats) -> Floats:
        """A wave (n, m), cut at the ends of the range, as the plant feels it, conditions behind it: (n, m + c)."""
        u = self.middle + self.reach * np.clip(wave, -1.0, 1.0)
        return np.hstack([u, np.tile(np.array(self.held), (len(u), 1))]) if self.held else u

    def moved(self, rival: Rival, u: Floats) -> tuple[Floats, Floats]:
        """States (n, nx) and readings (n, k) that a rival predicts from the start."""
        whole = Windows(*(np.array([k], dtype=np.int64) for k in (0, len(self.t), 0, 0)))
        problem = self._problem(u, np.zeros((len(self.t), len(self.sigma))), whole)
        begin = self.start[None, :]
        return problem.states(rival.theta, begin), problem.predict(rival.theta, begin)

    def stays(self, x: Floats) -> bool:
        """Whether states (n, nx) are finite and allowed."""
        return bool(np.all(np.isfinite(x)) and self.allowed.contains(x).all())

    def parts(self, states: Floats, readings: Floats, u: Floats, other: Rival) -> float:
        """D(A, B) of a rival A that moved like this and another one, in units of what the best explanation leaves."""
        problem, x0 = self.recorded(states, readings, u)
        directions = [slot_direction(problem, other.theta, k, h) for k, h in zip(other.slots, other.steps, strict=True)]
        linear = linearise(problem, other.theta, x0, directions)
        gram = linear.gram + other.information
        step = np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ linear.gradient
        left = linear.rest - 2.0 * float(linear.gradient @ step) + float(step @ gram @ step)
        return max(left, 0.0) / self.excess

    def errors(self, states: Floats, readings: Floats, u: Floats, own: Rival) -> Floats:
        """(p,) standard errors of a rival's own parameters after such a recording, with those at hand."""
        problem, x0 = self.recorded(states, readings, u)
        directions = [slot_direction(problem, own.theta, k, h) for k, h in zip(own.slots, own.steps, strict=True)]
        gram = linearise(problem, own.theta, x0, directions).gram + own.information
        return np.asarray(np.sqrt(np.diag(np.linalg.pinv(gram, hermitian=True)) * self.excess))

    def recorded(self, states: Floats, readings: Floats, u: Floats, whole: bool = False) -> tuple[Problem, Floats]:
        """The recording to come, without noise, in windows that tell (or all), and the states (w, nx) they begin at."""
        windows = self.windows if whole else self.windows.pick(self.tells)
        return self._problem(u, readings, windows), np.ascontiguousarray(states[windows.start])

    def _problem(self, u: Floats, y: Floats, windows: Windows) -> Problem:
        record = Record((self._trace(u, y),), self.model.measured, self.model.model.input_names)
        worth = weights(y, self.steps, self.shared) if np.any(self.steps > 0.0) else None
        return replace(build_problem(self.model, record, windows, self.sigma, worth), h_max=self.h_max)

    def _trace(self, u: Floats, y: Floats) -> Trace:
        return Trace("next", self.t, y, np.ascontiguousarray(u))


def margins(d: Floats, rivals: Sequence[Rival], bench: Bench) -> Floats:
    """How surely the one at [A, .] is told from the one at [., B] if it is right, in standard deviations, (r, r).

    BIC of B must exceed that of A by `BIC_GAIN`; the difference of their chi^2 has mean D and variance 4 D, and that
    of the parameters that one has more. d: (r, r) with D(A, B) at [A, B].
    """
    size = math.log(max(bench.counted + bench.compared, 2))
    more = np.array([[a.count - b.count for b in rivals] for a in rivals], dtype=np.float64)
    spread = np.sqrt(4.0 * d + 2.0 * np.maximum(np.abs(more), 1.0))
    z = (d - BIC_GAIN - more * size) / spread
    return np.where(np.eye(len(rivals), dtype=bool), np.inf, z)
