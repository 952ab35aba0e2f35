"""Judgement of a model on a fold that it was not fitted to, agreement of its coefficients, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import Judged, Key, Verdict
from simgap.diagnosis.search.confidence import (
    at_noise,
    chi2_dof,
    degrees_of_freedom,
    standard_errors,
    undetermined,
    vanishing,
)
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.noise_law import are_gross, limited
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY, LEAPS_ANYHOW, MATTERS, MOST, SURE
from simgap.diagnosis.verdict.horizon import HorizonError, horizon_error, look_back
from simgap.diagnosis.verdict.score import Errors, Gain

_RANK = 1e-8  # of the largest eigenvalue, and of a unit vector: what is less is not there


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Error of one parameter vector on windows that it was not fitted to.

    Attributes:
        states: (w, nx) initial states, refitted; rmse: (k,) with them; ratio: RMSE over noise, all channels together.
        chi2: with them; free: compared numbers less what the initial states took.
        heard: (k,) 1 for channels that are fitted.
        horizon: the causal error ahead; None if it was not asked for, or no stretch is long enough.
        errors: what it is scored by: the errors ahead, of the windows where there are none.
        stray: readings that are gross errors: `chi2` limits what one of them counts.
    """

    states: Floats
    rmse: Floats
    ratio: float
    chi2: float
    free: int
    heard: Floats
    horizon: HorizonError | None
    errors: Errors
    stray: int = 0

    @property
    def at_noise(self) -> bool:
        """Whether the error is no more than noise, as far as so few numbers can tell."""
        return at_noise(self.chi2, self.free)


def judge(held: Problem, theta: Floats, horizon_s: float) -> HeldOut:
    """Refit only the initial states (w, nx) of held-out windows at theta (q,), and predict ahead causally."""
    held = replace(held, usual=None)
    at = fit(held, theta, initial_states(held), [], {})
    plain = held.residuals(theta, at.x0)
    noise = np.ones(len(held.sigma))
    loss = limited(plain, noise)
    count, chi2 = held.size, float(np.sum(loss**2))
    unbiased = math.sqrt(max(1.0 - held.taken / count, 0.1))  # the initial states took some degrees of freedom
    rmse = np.sqrt(np.sum(held.misses(theta, at.x0) ** 2, axis=0) / held.compared) * held.sigma / unbiased
    ratio = math.sqrt(float(np.sum(plain**2)) / count) / unbiased
    free = max(round(count - held.taken), 1)
    ahead = _ahead(held, theta, horizon_s)
    errors = _misses(held, theta, at) if ahead is None else _blocks(held, ahead)
    return HeldOut(at.x0, rmse, ratio, chi2, free, held.heard, ahead, errors, int(np.sum(are_gross(loss, noise))))


def ahead_alone(held: Problem, theta: Floats, horizon_s: float, like: HeldOut) -> HeldOut:
    """What `judge` says of errors ahead, the rest `like` another's; all of it where no stretch is long enough."""
    ahead = _ahead(replace(held, usual=None), theta, horizon_s)
    return judge(held, theta, 0.0) if ahead is None else replace(like, horizon=ahead)


def errors_ahead(held: Problem, theta: Floats, horizon_s: float) -> Errors:
    """What `judge` scores a model by, and nothing else."""
    held = replace(held, usual=None)
    ahead = _ahead(held, theta, horizon_s)
    if ahead is not None:
        return _blocks(held, ahead)
    return _misses(held, theta, fit(held, theta, initial_states(held), [], {}))


def _ahead(held: Problem, theta: Floats, horizon_s: float) -> HorizonError | None:
    return horizon_error(held, theta, horizon_s) if horizon_s > 0.0 else None


def _misses(held: Problem, theta: Floats, at: Fit) -> Errors:
    """The misses, window by window."""
    misses = held.misses(theta, at.x0)[:, held.heard > 0.0]
    return Errors(misses, np.repeat(np.arange(len(held.windows)), np.diff(held.rows)))


def _blocks(held: Problem, ahead: HorizonError) -> Errors:
    """Errors ahead in blocks so long that none reaches past the next one."""
    trace = np.searchsorted(held.firsts, ahead.begin, side="right") - 1
    since, ends = held.t[ahead.begin] - held.t[held.firsts[trace]], held.t[ahead.end] - held.t[ahead.begin]
    length = float(np.max(ends)) + look_back(held)
    place = np.stack([trace, since // length], axis=1)
    errors = (ahead.error / held.sigma)[:, held.heard > 0.0]
    return Errors(errors, np.unique(place, axis=0, return_inverse=True)[1].ravel())


def judged(problem: Problem, at: Fit, held: HeldOut, horizon_s: float) -> Judged:
    """The figures of one model as they are reported."""
    names = problem.model.measured
    horizon = {} if held.horizon is None else dict(zip(names, map(float, held.horizon.rmse), strict=True))
    rmse = dict(zip(names, map(float, held.rmse), strict=True))
    return Judged(rmse, horizon_s, horizon, chi2_dof(problem, at), held.ratio)


def excess(held: HeldOut, floor: Floats | None, sigma: Floats) -> float:
    """Excess of E(h) over F(h), all fitted channels in units of their noise; of the windows without a horizon."""
    if held.horizon is None or floor is None:
        return math.sqrt(max(0.0, held.ratio**2 - 1.0))
    over = np.maximum(held.horizon.rmse**2 - floor**2, 0.0) / sigma**2
    return float(np.sqrt(np.mean(over[held.heard > 0.0])))


def excess_share(before: HeldOut, after: HeldOut, sigma: Floats) -> float:
    """Excess after over before, above the same floor; 1 if there was none."""
    floor = None if after.horizon is None else after.horizon.floor
    was = excess(before, floor, sigma)
    return excess(after, floor, sigma) / was if was > 0.0 else 1.0


def real(search: Search, found: Explanation, at_floor: bool) -> Explanation:
    """Without the effects whose interval contains "no effect", or of no practical size, and with what they contain in
    the place of those that refine it by a number the data do not give, where that is as good; one after another, the
    rest fitted again."""
    while found.members:
        gone, loose = (asked(search, found, at_floor) for asked in (vanished, _loose))
        gone = gone or (negligible(search, found) if at_floor else [])
        if gone:
            found = search.without(found, gone[0])
            continue
        plainer = [search.coarser(found, c) for c in loose]
        as_good = [e for e in plainer if e.bic - found.bic < BIC_GAIN]
        if not as_good:
            break
        found = as_good[0]
    return found


def vanished(search: Search, found: Explanation, at_floor: bool) -> list[Candidate]:
    """Its effects whose 95 % interval contains "no effect"."""
    if not found.members:
        return []
    return vanishing(search.problem, found.members, found.fit, *_errors(search, found, at_floor))


def _loose(search: Search, found: Explanation, at_floor: bool) -> list[Candidate]:
    return undetermined(found.members, found.fit, *_errors(search, found, at_floor))


def _errors(search: Search, found: Explanation, at_floor: bool) -> tuple[Floats, int]:
    """Standard errors (p,) of what was fitted, and the degrees of freedom of its intervals."""
    reduced = chi2_dof(search.problem, found.fit)
    errors = standard_errors(search.problem, found.fit, search.steps, reduced, at_floor)
    return errors, degrees_of_freedom(search.problem, found.fit, at_floor)


def negligible(search: Search, found: Explanation) -> list[Candidate]:
    """Members without which, the others fitted again, the predictions miss by next to nothing of the noise more.

    Nothing more is fitted where a search was stopped.
    """
    if search.watch.stopped:
        return []
    bar = MATTERS**2 * search.problem.size
    return [c for c in found.members if search.without(found, c).fit.chi2 - found.fit.chi2 < bar]


def slight(search: Search, found: Explanation, base: Fit) -> frozenset[Key]:
    """Faults of the recording that account for next to nothing of what the declared model misses.

    They stay fitted, as the noise is smaller still.
    """
    least = MATTERS**2 * (base.chi2 - found.fit.chi2)
    faults = [c for c in found.members if c.of_recording]
    return frozenset(c.key for c in faults if search.without(found, c).fit.chi2 - found.fit.chi2 < least)


def folds_agree(problem: Problem, found: Explanation, steps: dict[int, float], samples: float) -> bool:
    """Whether two halves of the fitted windows give the same coefficients, within their size or two standard errors.

    What a half does not show at all agrees. `samples` is how many samples one independent sample is worth: the standard
    errors grow with its root.
    """
    w = problem.windows
    traces = np.unique(w.trace)
    half = np.isin(w.trace, traces[: len(traces) // 2]) if len(traces) > 1 else np.arange(len(w)) < len(w) // 2
    if half.all() or not half.any():
        return False
    ends = []
    for side in (half, ~half):
        part = problem.on(w.pick(side))
        ends.append((part, fit(part, found.fit.theta, found.fit.x0[side], found.fit.slots, steps)))
    null, slots = problem.model.null, list(found.fit.slots)
    a, b = (e.theta[slots] - np.where(np.isfinite(null[slots]), null[slots], 0.0) for _, e in ends)
    variances = [_variances(e.covariance) * max(chi2_dof(part, e), 1.0) for part, e in ends]
    spread = np.sqrt(sum(variances) * samples)
    size = np.maximum(np.abs(a), np.abs(b))
    for c in found.members:
        if c.effect.one_curve:  # some of its values are near 0 where others are not
            own = np.isin(slots, c.slots)
            size[own] = size[own].max(initial=0.0)
    near = np.abs(a - b) <= np.maximum(MOST * size, SURE * spread)
    return bool(np.all(near))


def _variances(covariance: Floats) -> Floats:
    """Of coefficients by a pseudo-inverse (p, p), (p,); infinite for those that have a part in what was not seen."""
    own = np.maximum(np.diag(covariance), 0.0)
    size = np.sqrt(np.where(own > 0.0, own, 1.0))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    hidden = values <= _RANK * np.abs(values).max(initial=0.0)
    return np.where(np.sum(vectors[:, hidden] ** 2, axis=1) > _RANK, np.inf, own)


def needed(full: Search, found: Explanation, confirm: Problem, with_all: HeldOut) -> bool:
    """Whether leaving out any of the effects, the others fitted again to the known data, is worse on *confirm*."""
    if len(found.members) == 1:
        kept = [full.problem.model.null]
    else:
        kept = [full.without(found, c).fit.theta for c in found.members]
    return all(judge(confirm, theta, 0.0).chi2 > with_all.chi2 for theta in kept)


@dataclass(frozen=True)
class Evidence:
    """What a verdict is made of.

    Attributes:
        before, after: chi^2/dof of the fitted windows, of the declared and of the corrected model.
        declared, corrected: error on *confirm*; share: excess of the one over the other there.
        gain: what the corrected model predicts better, there and where sets competed.
        borne_out: whether that is of a size that matters there by itself, and no channel is predicted worse by as much.
        agree: whether the coefficients agree between halves of the fitted data.
        needed: whether *confirm* asks for each effect.
    """

    before: float
    after: float
    declared: HeldOut
    corrected: HeldOut
    share: float
    gain: Gain
    borne_out: bool
    agree: bool
    needed: bool

    @property
    def at_noise(self) -> bool:
        """Whether the fitted data and those that confirm are down to their noise."""
        return self.after <= FIT_QUALITY and self.corrected.at_noise

    def short_of(self, found: Explanation) -> tuple[str, ...]:
        """Why what is down to the noise is not surely it."""
        reasons = (
            (found.fit.converged, "The last fit had not converged."),
            (self.needed, "The data that confirm do not ask for each of these effects."),
            (self.agree, "Halves of the data give different numbers."),
        )
        return tuple(reason for holds, reason in reasons if not holds)

    @property
    def carries(self) -> bool:
        """Whether it surely predicts better what it was not fitted to."""
        return self.gain.sure and self.borne_out


def verdict(found: Explanation, evidence: Evidence) -> Verdict:
    """The table of verdicts; a fit that has not settled is never more than `partial`.

    More than `LEAPS_ANYHOW` effects bend to much: halves of the data must agree on them. Where faults of the recording
    alone explain the data down to their noise, the model lacks nothing; nor where it is at the noise as declared, and
    *confirm* does not ask for what was found.
    """
    if not found.members:
        return "none" if evidence.before <= FIT_QUALITY and evidence.declared.at_noise else "unexplained"
    if evidence.before <= FIT_QUALITY and evidence.declared.at_noise and not evidence.needed:
        return "none"
    plant = any(not c.of_recording for c in found.members)
    sure = evidence.agree or len(found.members) <= LEAPS_ANYHOW
    if evidence.at_noise and found.fit.converged and evidence.needed and sure:
        return "attributed" if plant else "none"
    if not plant:
        return "unexplained"
    return "partial" if evidence.carries and found.physical and evidence.agree else "unexplained"
