"""The initial state of each window, fitted at given parameters: every window by itself, from several starts.

Over the wells of a plant, at an unstable rest or under dry friction chi^2 of a window has several valleys. Each window
has a damping and an acceptance of its own, so that one that sticks under dry friction holds up no other.
Source: Levenberg (1944); Marquardt (1963), J. SIAM 11(2), window by window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.simulation.initial import at_rest, initial_states
from simgap.diagnosis.simulation.noise_law import LIMIT, are_gross
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import chunks, state_columns, state_steps, sums
from simgap.diagnosis.thresholds import FEWEST_WINDOWS, NEAR

SOONER = 10.0
"""Factor of a damping after a step that was taken, or rejected; of each further rejection in a row so much larger
(Nielsen (1999), Damping Parameter in Marquardt's Method): at a kink no step leads down, and that is soon known."""
PATIENCE = 5
"""Linear problems in a row that promise a useless end: a start is given up. Of the sets of 367 fits to two runs of a
rod (sac and ddp of the real recordings) one ended higher than where no start was given up, three at a patience of 3."""
_MOST = 20  # linearisations
_GROWING = (0.25, 0.5)  # shares of a window that is begun afresh, before all of it
_LADDER = (1000.0, 100.0, 10.0)  # sizes of a miss that count as usual, over what is
_SOFTEST, _SOFT, _STIFF = 1e-10, 1e-6, 1e6  # damping of a step: least, first, and where a window gives up


@dataclass(frozen=True, eq=False)
class Refit:
    """Where the windows ended: x0 (w, nx), chi2 (w,), and the decrease of chi^2 that was still promised (w,)."""

    x0: Floats
    chi2: Floats
    promise: Floats


def window_chi2(problem: Problem, theta: Floats, x0: Floats) -> Floats:
    """Sum of squared residuals over the noise of each window, (w,)."""
    parts = []
    for part in chunks(problem):
        sub = problem.pick(part)
        parts.append(sums(sub, sub.residuals(theta, x0[part])))
    return np.concatenate(parts)


def refit(problem: Problem, theta: Floats, x0: Floats, most: int = _MOST, useless: Floats | float = math.inf) -> Refit:
    """Fit the initial states alone, each window from its own x0: theta, (w, nx).

    A window for which `PATIENCE` linear problems in a row promise no less than its `useless` chi^2 (w,) is given up.
    """
    steps, limit = state_steps(x0), np.broadcast_to(useless, len(x0))
    out = [_refit(problem.pick(p), theta, x0[p], steps, most, limit[p]) for p in chunks(problem)]
    return Refit(*(np.concatenate(a) for a in zip(*((r.x0, r.chi2, r.promise) for r in out), strict=True)))


def refit_from_all(problem: Problem, theta: Floats, x0: Floats) -> Refit:
    """The best end of each window: from x0 (w, nx); under dry friction, and those that stand out, from all starts."""
    if problem.model.rubs(theta):
        return _from_starts(problem, theta, x0)
    best = _from_here(problem, theta, x0)
    return begun_afresh(problem, theta, best, stand_out(problem, theta, best.chi2))


def stand_out(problem: Problem, theta: Floats, chi2: Floats) -> Bools:
    """Windows (w,) whose chi^2 stands out of the others' by more than white noise does and, where there are enough,
    they scatter; gross errors may, in fewer than half of a window's readings: where most are, the fit follows what is
    disturbed."""
    size = chi2 / problem.counts
    if problem.usual is not None and not problem.model.rubs(theta):
        return np.asarray(size > 0.5 * LIMIT**2 * np.mean(np.square(problem.spread)))
    away = np.log(np.maximum(size, 1e-300) / np.maximum(np.median(size), 1e-300))
    scatter = 1.4826 * np.median(np.abs(away)) if len(size) > FEWEST_WINDOWS else 0.0
    return np.asarray(away > np.maximum(np.log1p(NEAR * np.sqrt(2.0 / problem.counts)), NEAR * scatter))


def begun_afresh(problem: Problem, theta: Floats, best: Refit, which: Bools) -> Refit:
    """The same, some windows from all starts."""
    lost = np.flatnonzero(which)
    if not lost.size:
        return best
    return better(best, _from_starts(problem.pick(lost), theta, best.x0[lost]), lost)


def _from_starts(problem: Problem, theta: Floats, x0: Floats) -> Refit:
    """From x0, and from the data's guess: fitted to a quarter of the window, to its half, then to all of it.

    Under dry friction from the guess as it is, and from rest: a window that begins stuck has a valley there.
    """
    best, guess = _from_here(problem, theta, x0), initial_states(problem)
    if problem.model.rubs(theta):
        for start in (guess, at_rest(problem, guess)):
            if not np.array_equal(start, x0):
                best = better(best, refit(problem, theta, start, useless=best.chi2))
        return best
    for share in _GROWING:
        guess = refit(problem.on(problem.windows.begun(share)), theta, guess).x0
    return better(best, refit(problem, theta, guess, useless=best.chi2))


def _from_here(problem: Problem, theta: Floats, x0: Floats) -> Refit:
    """From x0. Where misses may be gross errors all of them are at a bad start: windows that hold some are fitted from
    where nothing is one, then by steps from where what counts as usual shrinks."""
    best = refit(problem, theta, x0)
    if problem.usual is None:
        return best
    gross = are_gross(problem.residuals(theta, best.x0), problem.spread).any(axis=1)
    bad = np.flatnonzero(np.logical_or.reduceat(gross, problem.rows[:-1]))
    if not bad.size:
        return best
    part = problem.pick(bad)
    at = refit(replace(part, usual=None), theta, x0[bad]).x0
    for times in _LADDER:
        at = refit(replace(part, usual=times * part.spread * part.sigma), theta, at).x0
    return better(best, refit(part, theta, at, useless=best.chi2[bad]), bad)


def better(a: Refit, b: Refit, which: Ints | None = None) -> Refit:
    """Window by window the end with the smaller chi^2; b: of all windows, or of those `which`."""
    own = np.arange(len(a.chi2)) if which is None else which
    won = b.chi2 < a.chi2[own]
    found = replace(a, x0=a.x0.copy(), chi2=a.chi2.copy(), promise=a.promise.copy())
    found.x0[own[won]], found.chi2[own[won]], found.promise[own[won]] = b.x0[won], b.chi2[won], b.promise[won]
    return found


def _refit(problem: Problem, theta: Floats, x0: Floats, steps: Floats, most: int, useless: Floats) -> Refit:
    x0, w = x0.copy(), len(x0)
    chi2, gram, gradient = _normal(problem, theta, x0, steps)
    left, vain, damping, active = np.full(w, np.inf), np.ones(w), np.full(w, _SOFT), np.arange(w)
    harder, sub = np.full(w, SOONER), problem
    for _ in range(2 * most):
        step, own, promise = _damped(gram[active], gradient[active], damping[active])
        left[active] = promise
        vain[active[chi2[active] - promise < useless[active]]] = 0
        least = 1e-4 * np.maximum(1.0, chi2[active] / problem.counts[active]) + 1e-7 * chi2[active]
        done = (own < least) | (vain[active] >= PATIENCE)
        active, step = active[~done], step[~done]
        if not active.size:
            break
        tried = x0[active] + step
        sub = sub if len(active) == len(sub.windows) else problem.pick(active)  # they only get fewer
        after, bent, pull = _normal(sub, theta, tried, steps)
        won = after < chi2[active]
        softer = np.maximum(damping[active] / SOONER, _SOFTEST)
        damping[active] = np.where(won, softer, damping[active] * harder[active])
        harder[active] = np.where(won, SOONER, harder[active] * SOONER)
        better = active[won]
        x0[better], chi2[better], gram[better], gradient[better] = tried[won], after[won], bent[won], pull[won]
        vain[better] += 1
        active = active[damping[active] < _STIFF]
    return Refit(x0, chi2, left)


def _normal(problem: Problem, theta: Floats, x0: Floats, steps: Floats) -> tuple[Floats, Floats, Floats]:
    """chi^2 (w,), J^T J (w, nx, nx) and J^T r (w, nx) of the initial states of each window."""
    centre, columns = state_columns(problem, theta, x0, steps)
    first = problem.rows[:-1]
    gram = np.add.reduceat(np.einsum("irk,jrk->ijr", columns, columns), first, axis=2).transpose(2, 0, 1)
    gradient = np.add.reduceat(np.einsum("irk,rk->ir", columns, centre), first, axis=1).T
    return sums(problem, centre), gram, gradient


def _damped(gram: Floats, gradient: Floats, damping: Floats) -> tuple[Floats, Floats, Floats]:
    """Steps (w, nx) with a damping for each window, and the decrease of chi^2 that they and undamped ones promise."""
    scale = np.sqrt(np.maximum(np.einsum("wii->wi", gram), 1e-300))
    unit = gram / (scale[:, :, None] * scale[:, None, :])
    right, eye = (gradient / scale)[:, :, None], np.eye(gram.shape[1])
    each = np.stack([unit + damping[:, None, None] * eye, unit + _SOFTEST * eye])
    step, full = np.linalg.solve(each, right)[..., 0] / scale
    own = 2.0 * np.einsum("wi,wi->w", step, gradient) - np.einsum("wi,wij,wj->w", step, gram, step)
    return step, own, np.einsum("wi,wi->w", full, gradient)
