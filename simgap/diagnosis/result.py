"""What a diagnosis is asked and what it answers: frozen values, no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Literal

from simgap.arrays import Floats
from simgap.effects import AppliedEffect
from simgap.effects.base import Quoted

Verdict = Literal["none", "attributed", "partial", "unexplained"]
Key = tuple[str, str]
"""Name of an effect and what it acts on."""


@dataclass(frozen=True)
class DiagnosisSettings:
    """Choices of the person; the defaults are those of the `measured` section.

    Attributes:
        window_s: length of the simulated windows, s.
        horizon_s: how far ahead the causal error E(h) is judged, s.
        noise: known noise of channels, state -> standard deviation; the others are estimated.
        effects: names of the effects that may be tried; all if empty.
        known: parameters of the plant that are not in doubt.
        within: state -> range in which the plant works (`domain.X`): readings that lie there are in the declared unit.
        max_effects: largest number of effects in one explanation; most_off_floor: of one that leaves more than noise,
            unless each further one takes most of what was left away.
        held_out_traces: names of traces that confirm; if empty, `held_out_share` of the record does.
        held_out_share: share of traces or of windows that confirms, and of those that choose (at most half of the
            rest).
        budget_s: CPU seconds that a diagnosis may take; the last answer that was judged then stands. None: what it
            needs.
    """

    window_s: float = 1.0
    horizon_s: float = 0.5
    noise: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    max_effects: int = 5
    most_off_floor: int = 3
    held_out_traces: tuple[str, ...] = ()
    held_out_share: float = 0.25
    budget_s: float | None = None


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % confidence interval; a discrete choice has the interval [value, value]."""

    value: float
    ci95: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """An effect that explains the residual.

    `alternatives` are sets that this data cannot tell from it; where a set replaces several effects together, it stands
    at each of them.
    """

    name: str
    on: str
    parameters: Mapping[str, Estimate]
    alternatives: tuple[tuple[Key, ...], ...] = ()

    @property
    def quoted(self) -> Quoted:
        """The parameters as a sentence quotes them."""
        return Quoted({symbol: asdict(p) for symbol, p in self.parameters.items()})


@dataclass(frozen=True)
class Alternative:
    """A whole set of effects that fits as well; `exact` if no data of this kind can tell it from the chosen one."""

    effects: tuple[AppliedEffect, ...]
    bic_excess: float
    exact: bool


@dataclass(frozen=True)
class Judged:
    """Error of one model on *confirm*, but for `chi2_dof`.

    Attributes:
        fit_rmse: windows with refitted initial states, state -> RMS error.
        horizon_s: h, s.
        horizon_rmse: E(h) with a causal initial state, state -> RMS error; empty if no held-out stretch is long enough.
        chi2_dof: of the windows of *fit* and *choose*.
        held_out_ratio: RMSE over noise on *confirm*, all channels together, initial states refitted.
    """

    fit_rmse: Mapping[str, float]
    horizon_s: float
    horizon_rmse: Mapping[str, float]
    chi2_dof: float
    held_out_ratio: float


@dataclass(frozen=True)
class CandidateScore:
    """How one effect did: promised drop of chi^2 beside the model as declared, and BIC gain where it was fitted alone.

    `chi2_dof` is what that fit left. `rejected` says why a fit was not admitted ("" if it was).
    """

    name: str
    on: str
    chi2_drop: float
    bic_gain: float | None
    parameters: Mapping[str, float]
    rejected: str = ""
    chi2_dof: float | None = None


@dataclass(frozen=True)
class Option:
    """One effect that could be added at a step: chi^2/dof with it, what BIC gains by it, whether the answer has it."""

    name: str
    on: str
    chi2_dof: float
    bic_gain: float
    taken: bool


@dataclass(frozen=True)
class Step:
    """One step to the answer: chi^2/dof before it, and what was fitted there, what was taken first."""

    chi2_dof: float
    options: tuple[Option, ...]


@dataclass(frozen=True)
class Collinear:
    """Two candidates that this excitation can hardly tell apart, with the correlation of their sensitivities."""

    first: Key
    second: Key
    correlation: float
    advice: str


@dataclass(frozen=True, eq=False)
class WindowPrediction:
    """One window: samples, and predictions of the measured states before and after, initial state refitted in both.

    Attributes:
        trace: name of the trace; held_out: whether it is of *confirm*.
        t: (n,) s; measured, before, after: (n, k).
        states: (n, nx) states of the corrected model; inputs: (n, m) recorded inputs.
        used: (n, k) 1 for readings that are compared, 0 for those that are no measurement.
    """

    trace: str
    held_out: bool
    t: Floats
    measured: Floats
    before: Floats
    after: Floats
    states: Floats
    inputs: Floats
    used: Floats


@dataclass(frozen=True)
class RecordingFault:
    """A fault of the data and not of the plant.

    Attributes:
        fault: its kind, such as `coloured_noise`; channel: the state or input ("" for all).
        value, unit: its size in numbers; None where it has none.
        sentence: what was found; remedy: what to do.
    """

    fault: str
    channel: str
    value: float | None
    unit: str
    sentence: str
    remedy: str


@dataclass(frozen=True)
class Nearest:
    """What comes nearest where no effect is named: the share of the excess that it explains, why it falls short."""

    effects: tuple[FoundEffect, ...]
    share: float
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class LeftOver:
    """An effect that would take away a share of the error that is left, but is not named."""

    effect: FoundEffect
    share: float


@dataclass(frozen=True)
class Concentrated:
    """Where a small part of the time on *confirm* carries most of the squared error that is left.

    Attributes:
        stretches: the places; error_share: of the squared error there.
        excess_share_without: excess of E(h) after over before, each without what overlaps as many of its own worst.
        median_before, median_after: state -> median of the errors h ahead, all of them.
    """

    stretches: Stretches
    error_share: float
    excess_share_without: float
    median_before: Mapping[str, float]
    median_after: Mapping[str, float]


Stretches = tuple[tuple[str, float, float], ...]
"""(trace, from, to) in s."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer.

    Attributes:
        verdict: as in the table of verdicts.
        effects: what explains the residual (empty for `none` and `unexplained`).
        alternatives: whole sets that fit as well.
        before, after: error of the declared and of the corrected model.
        floor: what a perfect model would show with this noise (chi2_dof and held_out_ratio are 1).
        excess_share: excess of E(h) over the floor, after over before (1 if there was none).
        explained_error: off the noise floor, the share of the error's scale that goes on data which the effects were
            not fitted to, by the log density of the errors, and the ends of its 95 % interval; else None.
        sigma: noise of each measured state.
        candidates: every effect tried.
        steps: from the model as declared to the set that was chosen, one effect at a time; a last one takes none, if
            more was fitted there.
        collinear: candidates that this excitation can hardly tell apart.
        folds: what `fit` is made of, what `choose`, for the choice among sets, and what `confirm`, which the errors and
            the verdict are from.
        warnings: what a person should know.
        applied: the effects with their numbers.
        windows: predictions for plots.
        nearest: what comes nearest where the verdict is `unexplained`; None if nothing explains a tenth.
        left_over: effects of the library that would take away a part of what is left; None if the fitted data are down
            to their noise, so that there was nothing to test.
        concentrated: where the error is, if a small part of the time carries most of it.
        recording: faults of the data, which the answer accounts for.
        at_most: the limit on the number of effects, if a person set one and the answer has as many; else None.
        doubts: why an answer that is down to the noise may be another, in sentences; empty for others.
        stopped: why the search ended early, in a sentence; empty if it did not.
        unconfirmed: readings and inputs that go further where times left out begin than in other data.
        faint_memory: channels of which a part of the noise alone remembers, so that the answer is not attributed.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    alternatives: tuple[Alternative, ...]
    before: Judged
    after: Judged
    floor: Judged
    excess_share: float
    sigma: Mapping[str, float]
    candidates: tuple[CandidateScore, ...]
    collinear: tuple[Collinear, ...]
    folds: Mapping[str, Stretches]
    warnings: tuple[str, ...]
    applied: tuple[AppliedEffect, ...]
    windows: tuple[WindowPrediction, ...]
    nearest: Nearest | None = None
    left_over: tuple[LeftOver, ...] | None = None
    concentrated: Concentrated | None = None
    recording: tuple[RecordingFault, ...] = ()
    steps: tuple[Step, ...] = ()
    doubts: tuple[str, ...] = ()
    stopped: str = ""
    unconfirmed: tuple[str, ...] = ()
    faint_memory: tuple[str, ...] = ()
    at_most: int | None = None
    explained_error: tuple[float, float, float] | None = None
