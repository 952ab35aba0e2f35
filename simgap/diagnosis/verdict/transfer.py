"""Choice among explanations when none reaches the noise floor: the one that carries over to data never fitted.

Real plants keep something that no effect explains. Its residual is large and smooth, so that samples are not
independent and BIC at the noise level would add effects without end. BIC is therefore taken at the size of that
residual and at its number of independent samples, and among its best sets the held-out causal error decides: gain,
inertia and dry friction can stand for each other within one trace, but only the right one carries over to another.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.selection import grow
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import BEAM, EXCESS_KEPT, PLAUSIBLE_RATIO, SETS_JUDGED, SIMPLER_SHARE
from simgap.diagnosis.verdict.judge import HeldOut, chi2_dof, excess, folds_agree, judge, vanished

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Carried:
    """An explanation that carries over to held-out data, what it does there, and others that do as well."""

    search: Search
    chosen: Explanation
    held_out: HeldOut
    rivals: tuple[Explanation, ...]


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


def transferable(
    search: Search, base: Fit, best: Explanation, held: Problem, horizon_s: float, most: int
) -> Carried | None:
    """The explanation that at least halves the held-out excess and agrees between folds, or None.

    Among the best sets by BIC, the smallest held-out causal excess wins; one more parameter must lower it
    to `SIMPLER_SHARE`.
    """
    wider = rescaled(search, best)
    grow(wider, wider.empty(base), most)
    for size in range(1, most):  # a wider look than the greedy path: the right set need not fit best
        for e in _best(wider, size, BEAM):
            wider.joined(e, most=BEAM)
    pool = [
        e for size in range(1, most + 1) for e in _best(wider, size, SETS_JUDGED) if e.fit.converged and _plausible(e)
    ]
    before = judge(held, base.theta, horizon_s)
    ranked: list[tuple[float, Explanation, HeldOut]] = []
    for e in pool:
        after = judge(held, e.fit.theta, horizon_s)
        floor = None if after.horizon is None else after.horizon.floor
        was = excess(before, floor, held.sigma)
        share = excess(after, floor, held.sigma) / was if was > 0 else 1.0
        if share <= EXCESS_KEPT:
            ranked.append((share / SIMPLER_SHARE**e.count, e, after))
    ranked.sort(key=lambda item: item[0])
    share = independent_share(search.problem, best.fit)
    agreeing = [
        item
        for item in ranked
        if not vanished(search, item[1], False) and folds_agree(search.problem, item[1], search.steps, share)
    ]
    if not agreeing:
        return None
    chosen, after = agreeing[0][1:]
    rivals = [e for score, e, _ in agreeing[1:] if score <= agreeing[0][0] / SIMPLER_SHARE and e.count <= chosen.count]
    return Carried(wider, chosen, after, tuple(rivals))
