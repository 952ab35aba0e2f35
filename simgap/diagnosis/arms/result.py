"""What the diagnosis of an arm answers: frozen values, no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simgap.arrays import Floats
from simgap.diagnosis.result import Estimate, FoundEffect, RecordingFault, Verdict
from simgap.effects import AppliedEffect


@dataclass(frozen=True)
class BaseParameter:
    """A combination of inertial parameters that the motion shows: declared, and found (None: left as declared)."""

    name: str
    link: str
    unit: str
    declared: float
    found: Estimate | None


@dataclass(frozen=True)
class FoundPayload:
    """What was mounted on a link in some traces: mass, first moments and inertia about the link's joint."""

    link: str
    traces: tuple[str, ...]
    parameters: Mapping[str, Estimate]


@dataclass(frozen=True)
class Sought:
    """A term that was tried: its gain in BIC on *choose* when it was taken in, or why it was not."""

    name: str
    on: str
    gain: float | None
    reason: str


@dataclass(frozen=True, eq=False)
class Prediction:
    """Torques of one trace of *confirm*: measured, of the model as declared and as corrected, (R, n) over t (R,)."""

    trace: str
    t: Floats
    measured: Floats
    before: Floats
    after: Floats


@dataclass(frozen=True, eq=False)
class ArmDiagnosis:
    """The answer.

    Attributes:
        verdict: `none`, `attributed`, `partial` or `unexplained`.
        effects: what joints and links lack; applied: those that the library has, with their numbers.
        base: every base parameter; payloads: what was mounted.
        before, after, floor: RMS error of each input's torque on *confirm*; the floor is what white noise of the
            torques leaves behind the filter.
        per_trace: trace of *confirm* -> (before, after), input -> RMS each.
        beyond_friction: trace of *confirm* -> input -> RMS after, where a joint at rest counts only with what the dry
            friction that was found cannot hold.
        excess_share: excess over the floor, after over before.
        folds: fold -> traces; whole: whether they are whole traces.
        sought: every term and what became of it.
        cut_hz: cut of the low pass; independent: input -> rows of fit and choose that count as independent.
        predictions: for plots.
        recording: torque columns that are not what the case says; the verdict is about the others.
        warnings: what a person should know.
        inertial: link -> parameters (10,) of the corrected model, which bodies can have; empty if as declared.
        distance: of these from the base parameters that fit best, in standard errors.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    applied: tuple[AppliedEffect, ...]
    base: tuple[BaseParameter, ...]
    payloads: tuple[FoundPayload, ...]
    before: Mapping[str, float]
    after: Mapping[str, float]
    floor: Mapping[str, float]
    per_trace: Mapping[str, tuple[Mapping[str, float], Mapping[str, float]]]
    beyond_friction: Mapping[str, Mapping[str, float]]
    excess_share: float
    folds: Mapping[str, tuple[str, ...]]
    sought: tuple[Sought, ...]
    cut_hz: float
    independent: Mapping[str, float]
    predictions: tuple[Prediction, ...]
    recording: tuple[RecordingFault, ...]
    warnings: tuple[str, ...]
    inertial: Mapping[str, Floats]
    distance: float | None
