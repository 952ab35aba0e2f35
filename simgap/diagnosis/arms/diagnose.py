"""Diagnosis of an arm: from a tree of bodies and recorded torques to what joints and links lack.

With measured torques the equations of motion, read backwards, are linear in everything sought: inertial parameters,
friction, reflected inertia, bias. Least squares over whole traces takes seconds for six joints, where fitting simulated
windows takes minutes for two. Sources: Gautier (1997), IEEE ICRA; Swevers, Verdonck, De Schutter (2007), IEEE Control
Systems 27(5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.answer import ArmDiagnosis, Found, answer
from simgap.diagnosis.arms.fit import Choice, admissible, choose, correlation_rows, solve, spread, standard_errors
from simgap.diagnosis.arms.gains import SAID, Gains, gains, lone_gains, open_gains, scaled
from simgap.diagnosis.arms.inertia import BaseParameters, Consistent, base_parameters, consistent
from simgap.diagnosis.arms.motion import motions, rest_speeds
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, TERMS, Key, Part, Payload, folds_of, keys_of, part_of
from simgap.diagnosis.arms.torque_columns import faulty_columns, without
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.thresholds import SURE
from simgap.model.symbolic import Coordinate
from simgap.model.tree import Tree


@dataclass(frozen=True)
class ArmSettings:
    """Choices of the person.

    Attributes:
        held_out_traces, held_out_share: what confirms.
        most: largest number of effects of one joint.
        payloads: what was mounted in some traces.
        known: effects that the case declares, effect -> (n,) parameters.
    """

    held_out_traces: tuple[str, ...] = ()
    held_out_share: float = 0.25
    most: int = 3
    payloads: tuple[Payload, ...] = ()
    known: Mapping[str, Floats] = field(default_factory=dict)


def diagnose_arm(
    tree: Tree, record: Record, ends: Sequence[Coordinate], inputs: Sequence[str], settings: ArmSettings,
    tell: Callable[[str], None] = lambda words: None,
) -> ArmDiagnosis:  # fmt: skip
    """Attribute what the declared arm's torques lack.

    Args:
        tree: the arm as declared.
        record: traces with positions (velocities too, if measured) and torques.
        ends: the coordinate of each joint of the tree; inputs: the torque of each.

    Raises:
        UserError: a position that is not measured, too few traces.
    """
    every = motions(record, ends, inputs)
    tell(f"{len(every)} traces, smoothed below {every[0].low_pass.cut:.3g} Hz")
    base, rest = base_parameters(tree), rest_speeds(every)
    keys = keys_of(tree, base, inputs, settings.payloads)
    part = part_of(every, tree, base, settings.payloads, rest, settings.known)
    names = [m.trace for m in every]
    folds = folds_of(part, names, settings.held_out_traces, settings.held_out_share, settings.payloads)
    shared = [k for k, key in enumerate(keys) if key.effect in (INERTIAL, PAYLOAD)]
    weighed = any(p.mass is not None for p in settings.payloads)
    faults, silent, said = faulty_columns(folds.fit.beside(folds.choose), len(base.kept), inputs)
    folds = replace(folds, fit=without(folds.fit, silent), choose=without(folds.choose, silent))
    tell(f"{len(base.kept)} combinations of inertial parameters, {len(TERMS)} effects of each joint")
    chosen, weights, correlated, drives = _chosen(keys, inputs, folds.fit, folds.choose, shared, weighed, settings.most)
    known = folds.fit.beside(folds.choose)
    if drives is not None:
        known = scaled(known, drives.g, shared)
        said = said if weighed else (*said, SAID)
    active, theta, errors = _settled(keys, known, weights, chosen.active)
    if drives is not None:
        errors[shared] = drives.of_columns[shared]  # of a mass: with the gains open too
    noise = _noise(record, inputs, every[0].low_pass.noise_gain)
    used, bodies = _of_bodies(tree, base, keys, known, weights, correlated, active, theta, errors)
    found = Found(
        keys, base, active, theta, errors, chosen.gains, correlated, noise, used, bodies, drives, shared, faults,
        silent, said,
    )  # fmt: skip
    units = {c.name: c.force_unit for c in ends}
    return answer(tree, found, folds, names, inputs, units, settings.payloads, every[0].low_pass.cut)


def _chosen(
    keys: Sequence[Key], inputs: Sequence[str], fit: Part, judge: Part, shared: Sequence[int], weighed: bool, most: int
) -> tuple[Choice, Floats, Floats, Gains | None]:
    """Columns with weights and correlations of the joints, and drive gains where these explain *choose* better.

    Gains come first: with wrong ones no choice among the rest is right. Where other bodies stand beside them nothing
    tells the one from the other but a known mass, and what was chosen without gains stays.
    """
    weights, correlated = _weights(fit, len(keys))
    g: Floats | None
    if weighed:
        g = open_gains(fit, shared, weights, correlated)
    else:
        chosen = choose(keys, fit, judge, weights, correlated, most, len(inputs))
        g = lone_gains(keys, inputs, fit, judge, weights, correlated, most, chosen.bic)
        if g is None:
            return chosen, weights, correlated, None
    known, fit, judge = fit.beside(judge), scaled(fit, g, shared), scaled(judge, g, shared)
    scales, drives = _weights(fit, len(keys)), None
    right = choose(keys, fit, judge, *scales, most, len(inputs))
    if weighed or not any(keys[k].effect == INERTIAL for k in right.active):
        active, theta, _ = _settled(keys, fit.beside(judge), scales[0], right.active)
        right = replace(right, active=active)
        among = [j for j in range(len(inputs)) if weighed or g[j] != 1.0]
        drives = gains(known, active, [k for k in active if k in shared], theta, *scales, among)
    return (right, *scales, drives) if weighed or drives is not None else (chosen, weights, correlated, None)


def _weights(part: Part, size: int) -> tuple[Floats, Floats]:
    """(n,) one over the spread that every column together leaves, and rows that count as one there."""
    weights = 1.0 / np.maximum(spread(part, np.zeros(size)), 1e-12)
    theta = np.zeros(size)
    for _ in range(3):
        theta = solve(*part.grams(weights), range(size))
        weights = 1.0 / np.maximum(spread(part, theta), 1e-12)
    return weights, correlation_rows(part, theta)


def _settled(
    keys: Sequence[Key], known: Part, weights: Floats, active: tuple[int, ...]
) -> tuple[tuple[int, ...], Floats, Floats]:
    """Coefficients on fit and choose; terms whose 95 % interval holds 0, or of the wrong sign, go one by one."""
    gram, right = known.grams(weights)
    while True:
        theta = solve(gram, right, active)
        errors = standard_errors(known, theta, active, weights, correlation_rows(known, theta))
        doubtful = _doubtful(keys, active, theta, errors)
        if not doubtful:
            return active, theta, errors
        least = min(doubtful, key=lambda k: doubtful[k])
        active = tuple(k for k in active if k != least)


def _doubtful(keys: Sequence[Key], active: Sequence[int], theta: Floats, errors: Floats) -> dict[int, float]:
    """Terms of the wrong sign or whose 95 % interval holds 0, and how many standard errors they are from 0."""
    return {
        k: abs(theta[k]) / max(errors[k], 1e-300)
        for k in active
        if keys[k].effect in TERMS and (abs(theta[k]) < SURE * errors[k] or not admissible(keys[k], theta[k]))
    }


def _of_bodies(
    tree: Tree, base: BaseParameters, keys: Sequence[Key], known: Part, weights: Floats, correlated: Floats,
    active: tuple[int, ...], theta: Floats, errors: Floats,
) -> tuple[Floats, Consistent | None]:  # fmt: skip
    """Coefficients with inertial parameters that bodies can have, the rest fitted again beside them.

    A term that is of the wrong sign there, or whose 95 % interval holds 0 there, goes: `_settled` dropped the others.
    """
    size = len(base.kept)
    if not set(range(size)) <= set(active):
        return theta, None
    gram, right = known.grams(weights)
    rest = [k for k in active if k >= size]
    across = gram[:size][:, rest]
    information = gram[:size, :size] - across @ np.linalg.pinv(gram[np.ix_(rest, rest)], hermitian=True) @ across.T
    declared = base.combine @ tree.inertial.ravel()
    bodies = consistent(tree, base, declared + theta[:size], information / float(correlated.mean()))
    if bodies is None:
        return theta, None
    own = np.zeros(len(keys))
    own[:size] = base.combine @ bodies.inertial.ravel() - declared
    while True:
        used = own + solve(gram, right - gram @ own, rest)
        doubtful = _doubtful(keys, rest, used, errors)
        if not doubtful:
            return used, bodies
        rest.remove(min(doubtful, key=lambda k: doubtful[k]))


def _noise(record: Record, inputs: Sequence[str], gain: float) -> Floats:
    """(n,) what white noise of the torques leaves behind the filter."""
    swapped = tuple(Trace(t.name, t.t, t.u, t.u[:, :0]) for t in record.traces)
    return gain * noise_floor(Record(swapped, record.inputs, ()))[[record.inputs.index(n) for n in inputs]]
