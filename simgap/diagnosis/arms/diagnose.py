"""Diagnosis of an arm: from a tree of bodies and recorded torques to what joints and links lack.

With measured torques the equations of motion, read backwards, are linear in everything sought: inertial parameters,
friction, reflected inertia, bias. Least squares over whole traces takes seconds for six joints, where fitting simulated
windows takes minutes for two. Sources: Gautier (1997), IEEE ICRA; Swevers, Verdonck, De Schutter (2007), IEEE Control
Systems 27(5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from simgap.arrays import Floats
from simgap.diagnosis.arms.answer import ArmDiagnosis, Found, answer
from simgap.diagnosis.arms.fit import SAID, as_bodies, chosen_columns, scaled, settled
from simgap.diagnosis.arms.inertia import base_parameters
from simgap.diagnosis.arms.problem import TERMS, Payload, folds_of, keys_of, motions, part_of, rest_speeds
from simgap.diagnosis.arms.torque_columns import faulty_columns, without
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate
from simgap.model.tree import Tree


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
    every = motions(record, ends, inputs)
    tell(f"{len(every)} traces, smoothed below {every[0].low_pass.cut:.3g} Hz")
    base, rest = base_parameters(tree), rest_speeds(every)
    keys = keys_of(tree, base, inputs, payloads)
    part = part_of(every, tree, base, payloads, rest, known)
    names = [m.trace for m in every]
    folds = folds_of(part, names, settings.held_out_traces, settings.held_out_share, payloads)
    shared = [k for k, key in enumerate(keys) if key.joint is None]
    weighed, most = any(p.mass is not None for p in payloads), settings.most_off_floor
    faults, silent, said = faulty_columns(folds.fit.beside(folds.choose), len(base.kept), inputs)
    folds = replace(folds, fit=without(folds.fit, silent), choose=without(folds.choose, silent))
    tell(f"{len(base.kept)} combinations of inertial parameters, {len(TERMS)} effects of each joint")
    chosen, weights, correlated, drives = chosen_columns(keys, inputs, folds.fit, folds.choose, shared, weighed, most)
    seen = folds.fit.beside(folds.choose)
    if drives is not None:
        seen = scaled(seen, drives.g, shared)
        said = said if weighed else (*said, SAID)
    active, theta, errors = settled(keys, seen, weights, chosen.active)
    if drives is not None:
        errors[shared] = drives.of_columns[shared]  # of a mass: with the gains open too
    noise = _noise(record, inputs, every[0].low_pass.noise_gain)
    used, bodies = as_bodies(tree, base, keys, seen, weights, correlated, active, theta, errors)
    found = Found(
        keys, base, active, theta, errors, chosen.gains, correlated, noise, used, bodies, drives, shared, faults,
        silent, said,
    )  # fmt: skip
    units = {c.name: c.force_unit for c in ends}
    return answer(tree, found, folds, names, inputs, units, payloads, every[0].low_pass.cut)


def _noise(record: Record, inputs: Sequence[str], gain: float) -> Floats:
    """(n,) what white noise of the torques leaves behind the filter."""
    swapped = tuple(Trace(t.name, t.t, t.u, t.u[:, :0]) for t in record.traces)
    return gain * noise_floor(Record(swapped, record.inputs, ()))[[record.inputs.index(n) for n in inputs]]
