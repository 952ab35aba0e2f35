"""Weighted least squares of an arm's torques with honest intervals, the columns that explain them, and drive gains.

Columns are chosen joint by joint on data that they were not fitted to: forward selection by BIC on *choose* of
coefficients fitted to *fit*, with the inertial parameters as declared and with all their combinations free; the limit
on the number of terms is each joint's own.

Gains and masses that are all larger by one factor move an arm alike; a known mass sets the scale, and what several
joints feel ties their gains together. Source: Gautier, Briot (2014), J. Dynamic Systems, Measurement, and Control
136(5). There currents are regressors and their noise biases the gains; here they are what is predicted:

    u_j = g_j (d_j + X_s theta_s) + X_f theta_f,    g_j = declared gain over the true one,

d the torque of the declared bodies and of the known mass, X_s columns that joints share (inertial parameters, the rest
of the payload), X_f those of the joint alone (friction, in units of the declared gain). Gauss-Newton from g = 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.inertia import BaseParameters, Consistent, consistent
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, TERMS, Key, Part
from simgap.diagnosis.record.noise import samples_as_one
from simgap.diagnosis.simulation.sensitivity import inverted
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN, MOST, SURE
from simgap.effects import effect
from simgap.model.tree import Tree

Found = TypeVar("Found")
_OWN = 1e-3  # a term of which less (of its norm) is not what others do is not sought beside them
EXPECTED = ("viscous_friction", "coulomb_friction")
"""What every drive with a gear has."""


def solve(gram: Floats, right: Floats, active: Sequence[int]) -> Floats:
    """Coefficients of least squares over the active columns alone, (p,); directions not in the data stay 0."""
    theta, own = np.zeros(len(right)), np.array(active, dtype=np.int64)
    theta[own] = inverted(gram[np.ix_(own, own)]) @ right[own]
    return theta


def residual(part: Part, theta: Floats) -> Floats:
    """(R, n) measured torque less the model's."""
    return part.y - part.x @ theta


def spread(part: Part, theta: Floats) -> Floats:
    """(n,) RMS of what is left of each joint while it moves."""
    left = residual(part, theta)
    return np.sqrt((part.live * left**2).sum(axis=0) / np.maximum(part.live.sum(axis=0), 1.0))


def correlation_rows(part: Part, theta: Floats) -> Floats:
    """(n,) rows that count as one, by what is left of each joint."""
    left = residual(part, theta) * part.live
    stretches = np.split(left, np.flatnonzero(np.diff(part.trace)) + 1)
    joints = range(left.shape[1])
    return np.array([samples_as_one([own[:, [j]] for own in stretches], max(len(left) // 4, 1)) for j in joints])


def standard_errors(part: Part, theta: Floats, active: Sequence[int], weights: Floats, together: Floats) -> Floats:
    """(p,) standard errors that hold for residuals which are correlated in time and among joints.

    Newey, West (1987), Econometrica 55(3): the scores' autocovariances with Bartlett's weights, to three times the
    longest correlation.
    """
    own, out = np.array(active, dtype=np.int64), np.zeros(len(theta))
    scores = np.einsum("rjp,rj->rp", part.x[:, :, own], part.live * weights**2 * residual(part, theta))
    reach = int(min(3 * together.max(), len(scores) / 8))
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        same = (part.trace[lag:] == part.trace[:-lag])[:, None]
        cross = (scores[lag:] * same).T @ scores[:-lag]
        middle += (1.0 - lag / (reach + 1)) * (cross + cross.T)
    inverse = inverted(part.grams(weights)[0][np.ix_(own, own)])
    out[own] = np.sqrt(np.maximum(np.diag(inverse @ middle @ inverse), 0.0))
    return out


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen: columns, BIC on *choose*, and the gain of each term when it was taken in."""

    active: tuple[int, ...]
    bic: float
    gains: dict[int, float]


def choose(keys: Sequence[Key], fit: Part, judge: Part, weights: Floats, together: Floats, most: int) -> Choice:
    """The better of two selections: inertial parameters as declared, and free."""
    gram, right = fit.grams(weights)
    declared, free = (
        forward(keys, gram, right, judge, together, of_effect(keys, *given), most)
        for given in ((PAYLOAD,), (INERTIAL, PAYLOAD))
    )
    return free if free.bic < declared.bic - BIC_GAIN else declared


def of_effect(keys: Sequence[Key], *effects: str) -> tuple[int, ...]:
    """Columns of some effects."""
    return tuple(k for k, key in enumerate(keys) if key.effect in effects)


def forward(
    keys: Sequence[Key], gram: Floats, right: Floats, judge: Part, together: Floats, given: tuple[int, ...], most: int
) -> Choice:
    """Terms join the given columns one by one, the one that lowers BIC on *choose* most first; `most` of a joint."""
    active, gains = given, dict[int, float]()
    bic = _bic(gram, right, judge, together, active)
    while True:
        better = dict[int, float]()
        taken = [keys[k].joint for k in active]
        full = {None, *(j for j in taken if taken.count(j) >= most)}
        for k, key in enumerate(keys):
            if key.joint in full or k in active or not _own_direction(gram, active, k):
                continue
            trial = (*active, k)
            theta = solve(gram, right, trial)
            if all(admissible(keys[i], float(theta[i])) for i in trial):
                value = _bic(gram, right, judge, together, trial)
                if bic - value > (AS_GOOD if key.effect in EXPECTED else BIC_GAIN):
                    better[k] = value
        if not better:
            return Choice(active, bic, gains)
        best = min(better, key=lambda k: better[k])
        gains[best] = bic - better[best]
        bic, active = better[best], (*active, best)


def one_by_one(
    members: Sequence[int], fitted: Callable[[Sequence[int]], tuple[Found, dict[int, float]]]
) -> tuple[tuple[int, ...], Found]:
    """Members of which none is in doubt, and what was fitted to them: the most doubtful goes, the rest is fitted again.

    Args:
        fitted: of some members what they give, and how sure each is that is in doubt, in standard errors.
    """
    left = tuple(members)
    while True:
        found, doubtful = fitted(left)
        if not doubtful:
            return left, found
        left = tuple(k for k in left if k != min(doubtful, key=lambda k: doubtful[k]))


def doubted(
    members: Sequence[int], values: Floats, errors: Floats, keys: Sequence[Key] | None = None
) -> dict[int, float]:
    """Members whose 95 % interval holds 0, and how many standard errors they are from 0.

    Args:
        keys: of columns: then terms alone, those of the wrong sign among them.
    """
    return {
        k: abs(values[k]) / max(errors[k], 1e-300)
        for k in members
        if (keys is None or keys[k].effect in TERMS)
        and (abs(values[k]) <= SURE * errors[k] or not (keys is None or admissible(keys[k], values[k])))
    }


def weights_of(part: Part) -> tuple[Floats, Floats]:
    """(n,) one over the spread that every column together leaves, and rows that count as one there."""
    theta = np.zeros(part.x.shape[2])
    for _ in range(3):
        theta = solve(*part.grams(1.0 / np.maximum(spread(part, theta), 1e-12)), range(len(theta)))
    return 1.0 / np.maximum(spread(part, theta), 1e-12), correlation_rows(part, theta)


def settled(
    keys: Sequence[Key], known: Part, weights: Floats, active: tuple[int, ...]
) -> tuple[tuple[int, ...], Floats, Floats]:
    """Coefficients on fit and choose; terms whose 95 % interval holds 0, or of the wrong sign, go one by one."""
    gram, right = known.grams(weights)

    def fitted(some: Sequence[int]) -> tuple[tuple[Floats, Floats], dict[int, float]]:
        theta = solve(gram, right, some)
        errors = standard_errors(known, theta, some, weights, correlation_rows(known, theta))
        return (theta, errors), doubted(some, theta, errors, keys)

    kept, (theta, errors) = one_by_one(active, fitted)
    return kept, theta, errors


def admissible(key: Key, value: float) -> bool:
    """Whether an effect's parameter may have that value, such as a friction that does not push; no limit for others."""
    if key.effect not in TERMS:
        return True
    (p,) = effect(key.effect).parameters
    return p.lower <= value <= p.upper


def _bic(gram: Floats, right: Floats, judge: Part, together: Floats, active: tuple[int, ...]) -> float:
    """Of coefficients on a part that they were not fitted to: rows count as N / `together` independent ones."""
    independent = np.maximum(judge.live.sum(axis=0) / together, 1.0)
    size = np.maximum(spread(judge, solve(gram, right, active)), 1e-150)
    return float(2.0 * independent @ np.log(size) + len(active) * np.log(independent.sum()))


def _own_direction(gram: Floats, active: tuple[int, ...], k: int) -> bool:
    """Whether a column does something that the active ones together do not."""
    size = float(gram[k, k])
    return size > 0.0 and 1.0 - float(gram[k] @ solve(gram, gram[k], active)) / size > _OWN**2


GAIN = "input_gain"
SAID = (
    "The gains are relative to the declared masses: if all of these were off by one factor, other gains would fit; a "
    "payload of known mass decides (measured.payloads, mass)."
)


def lone_gains(
    keys: Sequence[Key], fit: Part, judge: Part, weights: Floats, together: Floats, most: int, bic: float
) -> Floats | None:
    """(n,) g of each drive, declared over true, 1 where it is as declared; None if no gain explains *choose* better.

    Args:
        bic: of what was chosen without gains.
    """
    joints = range(fit.y.shape[1])
    wider = [*keys, *(Key(GAIN, "", "ratio", j) for j in joints)]
    fitted, judged = (replace(p, x=np.concatenate([p.x, _for_gains(p.torque - p.y)], axis=2)) for p in (fit, judge))
    gram, right = fitted.grams(weights)
    chosen = forward(wider, gram, right, judged, together, of_effect(keys, PAYLOAD), most)
    g = 1.0 + solve(gram, right, chosen.active)[len(keys) :]
    off = int(np.sum(g != 1.0))
    explains = chosen.bic < bic - BIC_GAIN and 0 < off <= MOST * len(joints) and np.all(g > 0.0)
    return np.asarray(g) if explains else None


def _for_gains(bodies: Floats) -> Floats:
    """A column for each drive, (R, n, n): the torque that bodies ask for there, (R, n)."""
    return np.asarray(bodies[:, :, None] * np.eye(bodies.shape[1]))


_ROUNDS = 30
_SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class Gains:
    """(n,) g and its standard errors; (p,) standard errors of the columns beside it."""

    g: Floats
    errors: Floats
    of_columns: Floats


def scaled(part: Part, g: Floats, shared: Sequence[int]) -> Part:
    """The same rows with these gains: what is left of them, and the columns that joints share, as the currents say."""
    x = part.x.copy()
    x[:, :, shared] *= g[None, :, None]
    return replace(part, x=x, y=part.torque - g * (part.torque - part.y))


def gains(
    part: Part, active: Sequence[int], shared: Sequence[int], theta: Floats, weights: Floats, correlated: Floats,
    among: Sequence[int],
) -> Gains | None:  # fmt: skip
    """Gains of some joints and the active columns beside them, by Gauss-Newton. None if it does not settle.

    Args:
        shared: columns that several joints feel.
        theta: (p,) where to begin, 0 for columns that are not active, gains 1.
        among: joints whose gains may differ.
    """
    n = part.y.shape[1]
    free = [*among, *(n + k for k in active)]
    g, at = np.ones(n), theta.copy()
    for _ in range(_ROUNDS):
        rows = scaled(part, g, shared)  # what is left of them, with a column for each gain in front of the others
        columns = _for_gains(part.torque - part.y + part.x[:, :, shared] @ at[shared])
        rows = replace(rows, x=np.concatenate([columns, rows.x], axis=2), y=rows.y - rows.x @ at)
        step = solve(*rows.grams(weights), free)
        g, at = g + step[:n], at + step[n:]
        if not np.all(g > 0.0):
            return None
        if np.abs(step[:n]).max() < _SETTLED:
            errors = standard_errors(rows, step, free, weights, correlated)
            return Gains(g, errors[:n], errors[n:])
    return None


def chosen_columns(
    keys: Sequence[Key], fit: Part, judge: Part, shared: Sequence[int], weighed: bool, most: int
) -> tuple[Choice, Floats, Floats, Gains | None]:
    """Columns with weights and correlations of the joints, and drive gains where these explain *choose* better.

    Gains come first: with wrong ones no choice among the rest is right. Where other bodies stand beside them nothing
    tells the one from the other but a known mass, and what was chosen without gains stays. Those whose 95 % interval
    holds 1 are as declared.
    """
    scales, every = weights_of(fit), range(len(keys))
    plain: tuple[Choice, Floats, Floats, None] | None = None
    if weighed:  # beside every column at once, to begin from
        found = gains(fit, every, shared, np.zeros(len(keys)), *scales, range(fit.y.shape[1]))
        g = np.ones(fit.y.shape[1]) if found is None else found.g
    else:
        plain = choose(keys, fit, judge, *scales, most), *scales, None
        lone = lone_gains(keys, fit, judge, *scales, most, plain[0].bic)
        if lone is None:
            return plain
        g = lone
    known, fit, judge = fit.beside(judge), scaled(fit, g, shared), scaled(judge, g, shared)
    scales, drives = weights_of(fit), None
    right = choose(keys, fit, judge, *scales, most)
    if weighed or not any(keys[k].effect == INERTIAL for k in right.active):
        active, theta, _ = settled(keys, fit.beside(judge), scales[0], right.active)
        right = replace(right, active=active)

        def fitted(open_: Sequence[int]) -> tuple[Gains | None, dict[int, float]]:
            found = gains(known, active, shared, theta, *scales, open_) if open_ else None
            return found, {} if found is None else doubted(open_, found.g - 1.0, found.errors)

        _, drives = one_by_one([j for j in range(len(g)) if weighed or g[j] != 1.0], fitted)
    return plain if plain is not None and drives is None else (right, *scales, drives)


def as_bodies(
    tree: Tree, base: BaseParameters, keys: Sequence[Key], known: Part, weights: Floats, correlated: Floats,
    active: tuple[int, ...], theta: Floats, errors: Floats,
) -> tuple[Floats, Consistent | None]:  # fmt: skip
    """Coefficients with inertial parameters that bodies can have, the rest fitted again beside them.

    A term that is of the wrong sign there, or whose 95 % interval holds 0 there, goes: `settled` dropped the others.
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

    def fitted(some: Sequence[int]) -> tuple[Floats, dict[int, float]]:
        used = own + solve(gram, right - gram @ own, some)
        return used, doubted(some, used, errors, keys)

    return one_by_one(rest, fitted)[1], bodies
