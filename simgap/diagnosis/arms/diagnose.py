"""Diagnosis of an arm: from a tree of bodies and recorded torques to what joints and links lack.

With measured torques the equations of motion, read backwards, are linear in everything sought: inertial parameters,
friction, reflected inertia, bias. Least squares over whole traces takes seconds for six joints, where fitting simulated
windows takes minutes for two. Sources: Gautier (1997), IEEE ICRA; Swevers, Verdonck, De Schutter (2007), IEEE Control
Systems 27(5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.fit import SAID, Gains, as_bodies, chosen_columns, residual, scaled, settled
from simgap.diagnosis.arms.inertia import BaseParameters, Consistent, base_parameters
from simgap.diagnosis.arms.problem import (
    INERTIAL,
    PAYLOAD,
    TERMS,
    ArmFolds,
    Key,
    Part,
    Payload,
    folds_of,
    keys_of,
    motions,
    part_of,
    payload_columns,
)
from simgap.diagnosis.arms.torque_columns import faulty_columns, without
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings, Estimate, FoundEffect, RecordingFault, Verdict, WindowPrediction
from simgap.diagnosis.thresholds import FIT_QUALITY, SURE
from simgap.diagnosis.verdict.score import Errors, Gain, gained
from simgap.effects import AppliedEffect, effect
from simgap.model.symbolic import Coordinate
from simgap.model.tree import PARAMETERS, UNITS, Tree


def diagnose_arm(
    tree: Tree, record: Record, ends: Sequence[Coordinate], inputs: Sequence[str], settings: DiagnosisSettings,
    payloads: Sequence[Payload], known: Mapping[str, Floats], tell: Callable[[str], None],
) -> ArmDiagnosis:  # fmt: skip
    """Attribute what the declared arm's torques lack.

    Args:
        tree: the arm as declared.
        record: traces with positions (velocities too, if measured) and torques.
        ends: the coordinate of each joint of the tree; inputs: the torque of each.
        settings: what confirms, and as `most_off_floor` the largest number of effects of one joint.
        payloads: what was mounted in some traces; known: effects that the case declares, effect -> (n,) parameters.

    Raises:
        UserError: a position that is not measured, too few traces.
    """
    every, low_pass = motions(record, ends, inputs)
    tell(f"{len(every)} traces, smoothed below {low_pass.cut:.3g} Hz")
    base = base_parameters(tree)
    keys = keys_of(tree, base, inputs, payloads)
    part = part_of(every, low_pass, tree, base, payloads, known)
    names = [m.trace for m in every]
    folds = folds_of(part, names, settings.held_out_traces, settings.held_out_share, payloads)
    shared = [k for k, key in enumerate(keys) if key.joint is None]
    weighed, most = any(p.mass is not None for p in payloads), settings.most_off_floor
    faults, silent, said = faulty_columns(folds.fit.beside(folds.choose), len(base.kept), inputs)
    folds = replace(folds, fit=without(folds.fit, silent), choose=without(folds.choose, silent))
    tell(f"{len(base.kept)} combinations of inertial parameters, {len(TERMS)} effects of each joint")
    chosen, weights, correlated, drives = chosen_columns(keys, folds.fit, folds.choose, shared, weighed, most)
    none = np.zeros(len(inputs))
    of = drives or Gains(none + 1.0, none, np.zeros(len(keys)))
    seen = scaled(folds.fit.beside(folds.choose), of.g, shared)
    active, theta, errors = settled(keys, seen, weights, chosen.active)
    if drives is not None:
        errors[shared] = drives.of_columns[shared]  # of a mass: with the gains open too
        said = said if weighed else (*said, SAID)
    noise = _noise(record, inputs, low_pass.noise_gain)
    used, bodies = as_bodies(tree, base, keys, seen, weights, correlated, active, theta, errors)
    found = Found(
        keys, base, active, theta, errors, chosen.gains, correlated, noise, used, bodies, of, shared, faults,
        silent, said,
    )  # fmt: skip
    units = {c.name: c.force_unit for c in ends}
    return answer(tree, found, folds, names, inputs, units, payloads, low_pass.cut)


def _noise(record: Record, inputs: Sequence[str], gain: float) -> Floats:
    """(n,) what white noise of the torques leaves behind the filter."""
    swapped = tuple(Trace(t.name, t.t, t.u, t.u[:, :0]) for t in record.traces)
    return gain * noise_floor(Record(swapped, record.inputs, ()))[[record.inputs.index(n) for n in inputs]]


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
class ArmDiagnosis:
    """The answer.

    Attributes:
        verdict: `none`, `attributed`, `partial` or `unexplained`.
        effects: what joints and links lack; applied: those that the library has, with their numbers.
        base: every base parameter; payloads: what was mounted.
        before, after, floor: RMS error of each input's torque on *confirm*; the floor is what white noise of the
            torques leaves behind the filter.
        by_trace: trace of *confirm* -> `before`, `after`, and `after_beyond_friction`, where a joint at rest counts
            only with what the dry friction that was found cannot hold: input -> RMS each.
        excess_share: excess over the floor, after over before.
        explained_error: where more than the floor is left, as of every diagnosis.
        folds: fold -> traces; whole: whether they are whole traces.
        sought: every term and what became of it.
        cut_hz: cut of the low pass; independent: input -> rows of fit and choose that count as independent.
        predictions: torques of each trace of *confirm*, for plots.
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
    by_trace: Mapping[str, Mapping[str, Mapping[str, float]]]
    excess_share: float
    explained_error: tuple[float, float, float] | None
    folds: Mapping[str, tuple[str, ...]]
    sought: tuple[Sought, ...]
    cut_hz: float
    independent: Mapping[str, float]
    predictions: tuple[WindowPrediction, ...]
    recording: tuple[RecordingFault, ...]
    warnings: tuple[str, ...]
    inertial: Mapping[str, Floats]
    distance: float | None


@dataclass(frozen=True, eq=False)
class Found:
    """What the fit ended with.

    Attributes:
        keys, base: what the columns are; active: those that were chosen.
        theta, errors: (p,) coefficients that fit best and their standard errors; gains: in BIC.
        correlated: (n,) rows that count as one; noise: (n,) floor of each joint's torque.
        used: (p,) coefficients of the corrected model, whose inertial parameters bodies can have.
        bodies: these bodies; None: inertial parameters as declared, or none were found.
        drives: gains of the drives, 1 as declared; columns that are not `shared` by joints are in units of the declared
            gain.
        recording: faults of torque columns; silent: joints whose torques say nothing for that; said: warnings.
    """

    keys: tuple[Key, ...]
    base: BaseParameters
    active: tuple[int, ...]
    theta: Floats
    errors: Floats
    gains: Mapping[int, float]
    correlated: Floats
    noise: Floats
    used: Floats
    bodies: Consistent | None
    drives: Gains
    shared: Sequence[int]
    recording: tuple[RecordingFault, ...]
    silent: tuple[int, ...]
    said: tuple[str, ...]

    @property
    def dry(self) -> Floats:
        """(n,) dry friction of each joint."""
        own = {self.keys[k].joint: self.used[k] for k in self.active if self.keys[k].effect == "coulomb_friction"}
        return np.array([own.get(j, 0.0) for j in range(len(self.noise))])

    def estimate(self, k: int, unit: str, declared: float = 0.0) -> Estimate:
        """A coefficient, with what was declared, and its 95 % interval; of a joint alone: over its drive's gain."""
        at, joint = self.theta if self.keys[k].effect == INERTIAL else self.used, self.keys[k].joint
        value, error = declared + float(at[k]), float(self.errors[k])
        if joint is not None:
            g = float(self.drives.g[joint])
            value, error = value / g, float(np.hypot(error / g, value / g**2 * float(self.drives.errors[joint])))
        return Estimate(value, (value - SURE * error, value + SURE * error), unit)


def answer(
    tree: Tree, found: Found, folds: ArmFolds, names: Sequence[str], inputs: Sequence[str], units: Mapping[str, str],
    payloads: Sequence[Payload], cut_hz: float,
) -> ArmDiagnosis:  # fmt: skip
    """Put it together; here alone *confirm* is looked at."""
    part, after = folds.confirm, residual(scaled(folds.confirm, found.drives.g, found.shared), found.used)
    held = np.sign(after) * np.maximum(np.abs(after) - found.dry, 0.0)
    left = {"before": part.y, "after": after, "after_beyond_friction": np.where(part.live > 0.0, after, held)}
    heard = [j for j in range(tree.size) if j not in found.silent]
    errors = rms(part.y)[heard], rms(after)[heard], found.noise[heard]
    gain = gained(*(_density(own[:, heard], part, found, heard) for own in (part.y, after)))
    base = _base(tree, found)
    effects = (*_gains(found, inputs), *_terms(found, tree, units), *_links(base))
    word = verdict(*errors, gain, bool(effects))
    effects = effects if word in ("attributed", "partial") else ()
    kept = [e for e in effects if e.name != INERTIAL]
    rows = (folds.fit.live.sum(axis=0) + folds.choose.live.sum(axis=0)) / found.correlated

    def by_input(x: Floats) -> dict[str, float]:
        return dict(zip(inputs, map(float, x), strict=True))

    return ArmDiagnosis(
        verdict=word,
        effects=effects,
        applied=tuple(AppliedEffect(e.name, e.on, {s: p.value for s, p in e.parameters.items()}) for e in kept),
        base=base,
        payloads=_payloads(tree, found, payloads),
        before=by_input(rms(part.y)),
        after=by_input(rms(after)),
        floor=by_input(found.noise),
        by_trace={
            names[k]: {which: by_input(rms(own[part.trace == k])) for which, own in left.items()}
            for k in np.unique(part.trace)
        },
        excess_share=excess_share(*errors),
        explained_error=gain.share if word == "partial" else None,
        folds=folds.traces,
        sought=_sought(found),
        cut_hz=cut_hz,
        independent=by_input(rows),
        predictions=_predictions(part, part.torque - part.y, part.torque - after, names),
        recording=found.recording,
        warnings=_warnings(folds, found),
        inertial={} if found.bodies is None else dict(zip(tree.links, found.bodies.inertial, strict=True)),
        distance=None if found.bodies is None else found.bodies.distance,
    )


def rms(left: Floats) -> Floats:
    """(n,) RMS error of each joint's torque over rows (R, n)."""
    return np.asarray(np.sqrt(np.mean(left**2, axis=0)))


def excess_share(before: Floats, after: Floats, floor: Floats) -> float:
    """Excess over the floor, after over before, joints alike: each in units of its own excess before."""
    old, new = (np.maximum(e**2 - floor**2, 0.0) for e in (before, after))
    scale = np.maximum(before**2, 1e-300)
    return float(np.sqrt((new / scale).sum() / max(float((old / scale).sum()), 1e-300)))


def _density(left: Floats, part: Part, found: Found, heard: Sequence[int]) -> Floats:
    """Log density (b,) of errors (R, heard) over their noise, in blocks that hardly remember each other."""
    if not heard:
        return np.zeros(0)
    size = left / np.maximum(found.noise[heard], 1e-300)
    row, length = np.arange(len(size)) - np.searchsorted(part.trace, part.trace), 2.0 * found.correlated[heard].max()
    place = np.stack([part.trace, row // length], axis=1)
    return Errors(size, np.unique(place, axis=0, return_inverse=True)[1].ravel()).density()


def verdict(before: Floats, after: Floats, floor: Floats, gain: Gain, something: bool) -> Verdict:
    """The word: at the floor as declared, at the floor with the effects, surely better with them, or none of these."""
    if not len(floor):
        return "unexplained"  # no torque says anything
    old, new = (float(np.sqrt(np.mean((e / np.maximum(floor, 1e-300)) ** 2))) for e in (before, after))
    if old <= math.sqrt(FIT_QUALITY):
        return "none"
    if something and new <= math.sqrt(FIT_QUALITY):
        return "attributed"
    return "partial" if something and gain.sure else "unexplained"


def _gains(found: Found, inputs: Sequence[str]) -> list[FoundEffect]:
    """Gains of drives that are not as declared."""
    drives = zip(inputs, found.drives.g.tolist(), found.drives.errors.tolist(), strict=True)
    own = [(name, 1.0 / g, (1.0 / (g + SURE * e), 1.0 / max(g - SURE * e, 1e-300))) for name, g, e in drives]
    return [FoundEffect("input_gain", name, {"ratio": Estimate(r, e, "1")}) for name, r, e in own if r != 1.0]


def _terms(found: Found, tree: Tree, units: Mapping[str, str]) -> list[FoundEffect]:
    """Terms of joints, in the units of their forces."""
    out = []
    for k in sorted(found.active):
        key = found.keys[k]
        if key.joint is not None and found.used[k] != 0.0:
            (p,), force = effect(key.effect).parameters, units[tree.joints[key.joint]]
            unit = p.unit.format(force=force, position="m" if tree.slides[key.joint] else "rad", input=force)
            out.append(FoundEffect(key.effect, key.on, {key.symbol: found.estimate(k, unit)}))
    return out


def _base(tree: Tree, found: Found) -> tuple[BaseParameter, ...]:
    """Every combination, declared and found."""
    base, declared = found.base, (found.base.combine @ tree.inertial.ravel()).tolist()
    return tuple(
        BaseParameter(name, link, unit, own, found.estimate(k, unit, own) if k in found.active else None)
        for k, (name, link, unit, own) in enumerate(zip(base.names, base.links, base.units, declared, strict=True))
    )


def _links(base: Sequence[BaseParameter]) -> list[FoundEffect]:
    """One effect a link: its combinations that are not as declared."""
    out: dict[str, dict[str, Estimate]] = {}
    for b in base:
        if b.found is not None and not b.found.ci95[0] <= b.declared <= b.found.ci95[1]:
            out.setdefault(b.link, {})[b.name] = b.found
    return [FoundEffect(INERTIAL, link, parameters) for link, parameters in out.items()]


def _payloads(tree: Tree, found: Found, payloads: Sequence[Payload]) -> tuple[FoundPayload, ...]:
    columns, out = (k for k, key in enumerate(found.keys) if key.effect == PAYLOAD), []
    for p in payloads:
        values = {PARAMETERS[i]: found.estimate(next(columns), UNITS[i]) for i in payload_columns(tree, p)}
        out.append(FoundPayload(p.link, p.traces, values))
    return tuple(out)


_NOT_TAKEN = "improves too little on choose, has the wrong sign, or is covered by others"


def _sought(found: Found) -> tuple[Sought, ...]:
    rows = []
    for k, key in ((k, key) for k, key in enumerate(found.keys) if key.joint is not None):
        gain = found.gains.get(k)
        lost = "its interval holds 0" if gain else _NOT_TAKEN
        rows.append(Sought(key.effect, key.on, gain, "" if k in found.active and found.used[k] != 0.0 else lost))
    return tuple(rows)


def _predictions(part: Part, before: Floats, after: Floats, names: Sequence[str]) -> tuple[WindowPrediction, ...]:
    """Torques (R, n) as measured and as both models have them, a trace each."""
    out = []
    for k in np.unique(part.trace):
        rows = part.trace == k
        measured, none = part.torque[rows], np.zeros((np.count_nonzero(rows), 0))
        own = (measured, before[rows], after[rows], none, none, np.ones_like(measured))
        out.append(WindowPrediction(names[k], True, part.t[rows], *own))
    return tuple(out)


def _warnings(folds: ArmFolds, found: Found) -> tuple[str, ...]:
    said = list(found.said)
    if not folds.confirm.live.any():
        said.append(
            "Nothing moves in the confirming data: dry friction may balance any force there, so friction is not tested."
        )
    if found.bodies is None and any(found.keys[k].effect == INERTIAL for k in found.active):
        said.append(
            "No physically consistent inertial parameters were found: the corrected case keeps the declared ones."
        )
    return tuple(said)
