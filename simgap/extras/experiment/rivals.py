"""Explanations that the recordings at hand cannot tell apart, and how far one input would part them.

If rival A is right, the recording to come holds what A predicts and noise. What B would miss of it, its parameters
fitted again to all recordings and the initial state of each window free, is

    D(A, B) = min over d of |y_A - y_B - J_B d|^2 / sigma^2 + d^T G_B d,

J_B the sensitivities of B with the initial states projected out and G_B what the recordings at hand say of its
parameters. D / 2 is the expected logarithm of the likelihood ratio. Source: Atkinson, Fedorov (1975), Biometrika 62(1)
(T-optimality), here linearised in B's parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.noise import weights
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.confidence import chi2_dof
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.sensitivity import Linearised, choose_steps, linearise, slot_direction, with_values
from simgap.diagnosis.simulation.supermodel import Candidate, SuperModel
from simgap.diagnosis.thresholds import BIC_GAIN
from simgap.effects import EFFECTS, AppliedEffect
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined


@dataclass(frozen=True, eq=False)
class Rival:
    """An explanation, fitted to the recordings at hand.

    Attributes:
        label: what people read; theta: all parameters; steps: slots of the free ones, with their difference steps.
        count: number of parameters, discrete choices included.
        information: (p, p) of the free ones, from the recordings at hand.
    """

    label: str
    theta: Floats
    steps: Mapping[int, float]
    count: int
    information: Floats


@dataclass(frozen=True, eq=False)
class Bench:
    """Bench on which the next recording is made.

    Attributes:
        model: with the effects of all rivals; rivals: what is to be told apart; sigma: (k,) noise of the measured
            states.
        t: (n,) s; windows: of them, as the fit will cut them; tells: (w,) which it looks at; h_max: longest step, s.
        start: (nx,) state at the first sample; allowed: states that the plant may come to.
        middle, reach: (m,) of the inputs, or of those that are no known condition.
        held: values of the known conditions, after the inputs.
        excess: chi^2/dof that the best explanation leaves, at least 1; counted: numbers in the recordings at hand.
        steps, shared: (k,) counts of encoders, and what of the noise the readings of one count have in common.
    """

    model: SuperModel
    rivals: tuple[Rival, ...]
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
        """Number of values of the recording to come that are compared."""
        return self.windows.pick(self.tells).samples * len(self.sigma)

    def input(self, wave: Floats) -> Floats:
        """A wave (n, m), cut at the ends of the range, as the plant feels it, conditions behind it: (n, m + c)."""
        u = self.middle + self.reach * np.clip(wave, -1.0, 1.0)
        return np.hstack([u, np.tile(np.array(self.held), (len(u), 1))]) if self.held else u

    def moved(self, rival: Rival, u: Floats) -> tuple[Floats, Floats]:
        """States (n, nx) and readings (n, k) that a rival predicts from the start."""
        whole = Windows(*(np.array([k], dtype=np.int64) for k in (0, len(self.t), 0)))
        problem = self._problem(u, np.zeros((len(self.t), len(self.sigma))), whole)
        begin = self.start[None, :]
        return problem.states(rival.theta, begin), problem.predict(rival.theta, begin)

    def stays(self, x: Floats) -> bool:
        """True if states (n, nx) are finite and allowed."""
        return bool(np.all(np.isfinite(x)) and self.allowed.contains(x).all())

    def parts(self, states: Floats, readings: Floats, u: Floats, other: Rival) -> float:
        """D(A, B) of a rival A that moved like this and another one, in units of what the best explanation leaves."""
        linear, gram = self._linearised(states, readings, u, other)
        step = np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ linear.gradient
        left = linear.rest - 2.0 * float(linear.gradient @ step) + float(step @ gram @ step)
        return max(left, 0.0) / self.excess

    def errors(self, states: Floats, readings: Floats, u: Floats, own: Rival) -> Floats:
        """(p,) standard errors of a rival's own parameters after such a recording, with those at hand."""
        return self._errors(self._linearised(states, readings, u, own)[1])

    def errors_now(self, own: Rival) -> Floats:
        """(p,) the same with the recordings at hand alone."""
        return self._errors(own.information)

    def _errors(self, gram: Floats) -> Floats:
        return np.asarray(np.sqrt(np.diag(np.linalg.pinv(gram, hermitian=True)) * self.excess))

    def _linearised(self, states: Floats, readings: Floats, u: Floats, of: Rival) -> tuple[Linearised, Floats]:
        """The recording to come around a rival, and its normal matrix with what is at hand."""
        problem, x0 = self.recorded(states, readings, u)
        directions = [slot_direction(problem, of.theta, k, h) for k, h in of.steps.items()]
        linear = linearise(problem, of.theta, x0, directions)
        return linear, linear.gram + of.information

    def recorded(self, states: Floats, readings: Floats, u: Floats, whole: bool = False) -> tuple[Problem, Floats]:
        """The recording to come, without noise, in windows that tell (or all), and the states (w, nx) they begin at."""
        windows = self.windows if whole else self.windows.pick(self.tells)
        return self._problem(u, readings, windows), np.ascontiguousarray(states[windows.start])

    def _problem(self, u: Floats, y: Floats, windows: Windows) -> Problem:
        trace = Trace("next", self.t, y, np.ascontiguousarray(u))
        record = Record((trace,), self.model.measured, self.model.model.input_names)
        worth = weights(y, self.steps, self.shared) if np.any(self.steps > 0.0) else None
        return replace(build_problem(self.model, record, windows, self.sigma, worth), h_max=self.h_max)

    def margins(self, d: Floats) -> Floats:
        """Margins, (r, r), by which the one at [A, .] is told from that at [., B] if it is right; D(A, B) at [A, B]."""
        more = np.array([[a.count - b.count for b in self.rivals] for a in self.rivals], dtype=np.float64)
        return np.where(np.eye(len(d), dtype=bool), np.inf, margin(d, more, self.counted + self.compared))


def margin(d: Floats, more: Floats, numbers: int) -> Floats:
    """Margins in standard deviations by which what is right is told from another, from their difference d of chi^2.

    BIC of the other must exceed that of the right one by `BIC_GAIN`; the difference of their chi^2 has mean D and
    variance 4 D, and that of the parameters that one has `more`. numbers: of all recordings.
    """
    log = math.log(max(numbers, 2))
    spread = np.sqrt(4.0 * d + 2.0 * np.maximum(np.abs(more), 1.0))
    return np.asarray((d - BIC_GAIN - more * log) / spread)


_ROUNDS = 10  # what a diagnosis fitted is near its end already
Explained = Sequence[AppliedEffect]


@dataclass(frozen=True, eq=False)
class KnownRivals:
    """Explanations that the recordings at hand leave open.

    Attributes:
        problem: their windows; rivals: fitted to them, the answer of the diagnosis first.
        excess: chi^2/dof of the best of them, at least 1.
    """

    problem: Problem
    rivals: tuple[Rival, ...]
    excess: float


def known_rivals(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, sets: Sequence[Explained],
    noise: Mapping[str, float],
) -> KnownRivals:  # fmt: skip
    """Fit each set of effects to the recordings, begun where the diagnosis ended.

    Args:
        model, record, settings: of the diagnosis; noise: what it took for each measured state.
        sets: the answer and what cannot be told from it, with their numbers.
    """
    parts, _ = parts_of(model, record, replace(settings, noise=dict(noise), effects=library_names(sets)))
    problem = coarse(parts.known)
    found = [_fitted(problem, effects) for effects in sets]
    return KnownRivals(problem, tuple(r for r, _ in found), max(1.0, min(reduced for _, reduced in found)))


def library_names(sets: Sequence[Explained]) -> tuple[str, ...]:
    """Names of the effects in some sets, without faults of the recording, which every compiled model has."""
    names = dict.fromkeys(a.name for effects in sets for a in effects)
    return tuple(n for n in names if n in EFFECTS) or ("viscous_friction",)


def translated(rival: Rival, effects: Explained, here: SuperModel, there: SuperModel) -> Rival:
    """The same explanation in another compiled model of the same plant."""
    pairs = zip(members(here, effects), members(there, effects), strict=True)
    places = {k: new for own, other in pairs for k, new in zip(own.slots, other.slots, strict=True)}
    theta = with_values(there.null, {new: float(rival.theta[k]) for k, new in places.items()})
    return replace(rival, theta=theta, steps={places[k]: h for k, h in rival.steps.items()})


def members(model: SuperModel, effects: Explained) -> tuple[Candidate, ...]:
    """The candidates of a compiled model that a set of effects is made of.

    Raises:
        UserError: effects that the model cannot have: they are of another one.
    """
    there = {c.key for c in model.candidates}
    for a in effects:
        if (a.name, a.on) not in there:
            raise UserError(
                f"the diagnosis names '{a.name}' on '{a.on}', which this case cannot have", remedy="Diagnose it again."
            )
    return tuple(model.find(a.name, a.on) for a in effects)


def _fitted(problem: Problem, effects: Explained) -> tuple[Rival, float]:
    """A set fitted to a problem, and its chi^2/dof."""
    model = problem.model
    chosen = members(model, effects)
    values = {k: v for c, a in zip(chosen, effects, strict=True) for k, v in c.by_slot(a.values).items()}
    theta, x0 = with_values(model.null, values), initial_states(problem)
    slots = tuple(k for c in chosen for k in c.free)
    steps = choose_steps(problem, theta, x0, slots)
    ends = fit(problem, theta, x0, slots, steps, _ROUNDS)
    steps = choose_steps(problem, ends.theta, ends.x0, slots)
    directions = [slot_direction(problem, ends.theta, k, steps[k]) for k in slots]
    information = linearise(problem, ends.theta, ends.x0, directions).gram
    count = sum(len(c.slots) for c in chosen)
    label = joined([c.effect.phrase(c.on) for c in chosen]) or "the model as declared"
    return Rival(label, ends.theta, steps, count, information), chi2_dof(problem, ends)
