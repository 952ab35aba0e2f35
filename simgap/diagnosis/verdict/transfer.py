"""Choice among explanations when none reaches the noise floor: the one that carries over from *fit* to *choose*.

Real plants keep something that no effect explains. Its residual is large and smooth, so that samples are not
independent and BIC at the noise level would add effects without end. BIC is therefore taken at the size of that
residual and at its number of independent samples, and among its best sets, fitted to *fit* alone, the causal error on
*choose* decides: gain, inertia and dry friction can stand for each other within one trace, but only the right one
carries over to another. What is chosen is then fitted to both; *confirm* is not seen here.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.selection import grow
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import BEAM, PLAUSIBLE_RATIO, SETS_JUDGED, SIMPLER_SHARE
from simgap.diagnosis.verdict.judge import chi2_dof, excess_share, folds_agree, judge, vanished

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trial:
    """What sets compete on: fitted to `fit`, judged on `choose`, `horizon_s` ahead."""

    fit: Problem
    choose: Problem
    horizon_s: float


@dataclass(frozen=True, eq=False)
class Carried:
    """An explanation that carries over, fitted to both folds, others that do as well, whether halves agree on it."""

    search: Search
    chosen: Explanation
    rivals: tuple[Explanation, ...]
    agrees: bool


def independent_share(problem: Problem, at: Fit) -> float:
    """Samples that one independent sample is worth: 1 + 2 sum of the residuals' autocorrelation, at least 1.

    The sum stops where the autocorrelation first turns negative (Geyer (1992), Statistical Science 7(4)).
    """
    residual = problem.residuals(at.theta, at.x0)
    most = int(np.min(problem.windows.stop - problem.windows.start)) // 2
    sums = np.zeros(most)
    for a, b in itertools.pairwise(problem.rows.tolist()):
        part = residual[a:b]
        size = 1 << (2 * len(part) - 1).bit_length()
        power = np.abs(np.fft.rfft(part, size, axis=0)) ** 2
        sums += np.fft.irfft(power, size, axis=0).sum(axis=1)[:most]
    rho = sums / max(float(sums[0]), 1e-300)
    negative = np.flatnonzero(rho <= 0.0)
    last = int(negative[0]) if negative.size else most
    return max(1.0, 1.0 + 2.0 * float(rho[1:last].sum()))


def rescaled(search: Search, best: Explanation) -> Search:
    """The same search with BIC at the size of the best explanation's residual and its independent samples."""
    scale = max(1.0, chi2_dof(search.problem, best.fit)) * independent_share(search.problem, best.fit)
    wider = replace(search, scale=scale, tried={})
    wider.tried = {k: replace(e, bic=wider.bic(e.fit.chi2, e.count)) for k, e in search.tried.items()}
    return wider


def _best(search: Search, size: int, most: int) -> list[Explanation]:
    """The best physical sets of one size by BIC."""
    same = [e for e in search.tried.values() if e.physical and len(e.members) == size]
    return sorted(same, key=lambda e: e.bic)[:most]


def _plausible(e: Explanation) -> bool:
    """Whether no ratio of true to declared is beyond belief: such a fit bends the model to a force that it lacks."""
    values = [(p, e.fit.theta[k]) for c in e.members for p, k in zip(c.effect.parameters, c.slots, strict=True)]
    ratios = [v for p, v in values if p.symbol == "ratio" and p.null == 1.0]
    return all(1.0 / PLAUSIBLE_RATIO <= abs(r) <= PLAUSIBLE_RATIO for r in ratios)


def transferable(search: Search, base: Fit, best: Explanation, trial: Trial, most: int) -> Carried | None:
    """Among the best sets by BIC the one with the smallest causal excess on *choose*, or None if all vanish.

    One more parameter must lower the excess to `SIMPLER_SHARE`. Sets whose coefficients agree between halves of the
    data come first.
    """
    wider = rescaled(search, best)
    grow(wider, wider.empty(base), most)
    for size in range(1, most):  # a wider look than the greedy path: the right set need not fit best
        for e in _best(wider, size, BEAM):
            wider.joined(e, most=BEAM)
    pool = [
        e for size in range(1, most + 1) for e in _best(wider, size, SETS_JUDGED) if e.fit.converged and _plausible(e)
    ]
    shares = _shares(pool, base, trial, wider.steps)
    ranked = sorted(((s / SIMPLER_SHARE**e.count, e) for s, e in zip(shares, pool, strict=True)), key=lambda it: it[0])
    worth = independent_share(search.problem, best.fit)
    chosen, least, rivals = None, np.inf, []
    for score, e in ranked:
        if chosen is not None and (score > least / SIMPLER_SHARE or e.count > chosen.count):
            continue
        if not vanished(search, e, False) and folds_agree(search.problem, e, search.steps, worth):
            if chosen is None:
                chosen, least = e, score
            else:
                rivals.append(e)
    if chosen is not None:
        return Carried(wider, chosen, tuple(rivals), True)
    real_ones = [e for _, e in ranked if not vanished(search, e, False)]
    return Carried(wider, real_ones[0], (), False) if real_ones else None


def _shares(pool: Sequence[Explanation], base: Fit, trial: Trial, steps: dict[int, float]) -> list[float]:
    """Excess on *choose* of each set, fitted to *fit* alone, over that of the model as declared."""
    before = judge(trial.choose, base.theta, trial.horizon_s)
    start = fit(trial.fit, base.theta, initial_states(trial.fit), [], {})
    shares = []
    for e in pool:
        there = fit(trial.fit, e.fit.theta, start.x0, [], {})
        after = judge(trial.choose, fit(trial.fit, e.fit.theta, there.x0, e.fit.slots, steps).theta, trial.horizon_s)
        shares.append(excess_share(before, after, trial.choose.sigma))
    return shares
