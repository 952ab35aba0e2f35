"""Is what a model leaves the noise of a sensor that remembers, or the trace of a force?

A force reaches a position through two integrations: whatever it is, what it leaves there falls at least with the fourth
power of the frequency, from where the motion itself lies upward. What it leaves in a level, a current or a speed whose
position nobody reads falls with the second. Noise that a sensor or its filter makes falls with the second
too, and meets the white noise of the reading where no force could. So laws of the residual's spectrum compete by their
likelihood (Whittle (1953), Ark. Mat. 2(5)): white noise and noise with the autocorrelation exp(-|t| / tau), against
white noise and such a fall that begins within twice the motion's frequency. Only where the first wins by far, the
windows agree on its size, and the residual does not follow the input, is it taken for noise.

Whether it follows the input is a test of independence between residuals and past inputs (Ljung (1999), System
Identification, sec. 16.6): the residual is regressed on the inputs of the last samples and on their squares with their
sign, and the regression's F compared with chance. It is white already, so that chance needs no correction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.noise import rates
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.noise_law import Colour, whiten
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import state_columns, state_steps
from simgap.diagnosis.thresholds import A_FEW, BIC_GAIN, BY_CHANCE, FAR
from simgap.late import scipy
from simgap.statistics import chi2, fisher

Law = Callable[[Floats], Floats]
_FIRST = 3  # the initial states of a window take what is slower
OWN = 0.8
"""Mean worth of readings: those of an encoder that share its rounding are no noise that remembers."""
_ASKED = 20  # lags whose correlations are asked together
_LAGS = 1 + 2 * np.arange(12)  # samples; a command of the same one may be fed back from the reading, noise and all
_BINS = 1.5  # neighbouring frequencies that a Hann window makes one


def noise_colour(problem: Problem, theta: Floats, x0: Floats) -> tuple[Floats, Colour] | None:
    """Standard deviation (k,) over the problem's sigma, and law of the noise; None where the residual is no such noise.

    Args:
        problem: windows, noise taken as white.
        theta, x0: the model that explains them best, (q,) and (w, nx).
    """
    residual, dt = problem.misses(theta, x0), problem.spacing
    k = residual.shape[1]
    size, shared, tau = np.ones(k), np.zeros(k), np.full(k, dt)
    read, coordinates = problem.model.measured, problem.model.model.coordinates
    twice = {n for p in coordinates for n in (p.position, p.velocity) if n == p.position or p.position in read}
    for c, name in enumerate(read):
        motion = _motion(problem, c) if np.mean(problem.weight[:, c]) > OWN else 0.0
        falls = (2, 3) if name in twice else (1, 2, 3)
        law = _law(*_spectrum(problem, residual[:, c]), dt, motion, falls) if motion > 0.0 else None
        if law is not None:
            size[c], shared[c], tau[c] = law
    if not shared.any():
        return None
    colour = Colour(shared, tau, dt)
    white = np.ascontiguousarray(residual / size)
    whiten(white, problem.rows, *colour.memory)
    return (size, colour) if _stationary(problem, white) and not follows_input(problem, white) else None


def _motion(problem: Problem, c: int) -> float:
    """Root mean square frequency of what a channel reads, rad/s."""
    y = problem.readings[:, c]
    return float(np.sqrt(np.mean(rates(problem.t[problem.samples], y) ** 2) / max(float(np.var(y)), 1e-300)))


def _spectrum(problem: Problem, residual: Floats) -> tuple[Floats, float]:
    """Mean periodogram of the windows, (n // 2 - 1,) from the first frequency on, and how many it is the mean of."""
    lengths = np.diff(problem.rows)
    n = int(np.median(lengths)) - 1
    whole = np.flatnonzero(lengths >= n)
    taper = np.hanning(n + 2)[1:-1]
    taper /= np.sqrt(np.mean(taper**2))
    blocks = np.stack([residual[problem.rows[w] : problem.rows[w] + n] for w in whole])
    power = np.mean(np.abs(np.fft.rfft(blocks * taper, axis=1)) ** 2, axis=0) / n
    return np.asarray(power[1 : n // 2]), float(len(whole))


def _law(
    power: Floats, count: float, dt: float, motion: float, falls: Sequence[int]
) -> tuple[float, float, float] | None:
    """Standard deviation, share that remembers and tau (s) of the noise behind a spectrum; None if it is no such.

    falls: how a force may fall, each with twice that power of the frequency.
    """
    if len(power) < _FIRST + 5:  # three numbers are not to be had from fewer frequencies
        return None
    n = 2 * (len(power) + 1)
    turn = 2.0 * np.pi * np.arange(1, n // 2)[_FIRST - 1 :] / n  # rad a sample
    power = power[_FIRST - 1 :]
    worth = count / _BINS

    def remembering(z: Floats) -> Floats:
        a = np.exp(-dt / np.exp(z[2]))
        return np.asarray(np.exp(z[0]) + np.exp(z[1]) * (1 - a * a) / np.abs(1 - a * np.exp(-1j * turn)) ** 2)

    def falling(z: Floats, order: int) -> Floats:
        return np.asarray(np.exp(z[0]) + np.exp(z[1]) / (1.0 + (turn / dt * np.exp(z[2])) ** 2) ** order)

    white = float(np.log(np.mean(power)) + 1.0) * len(power) * worth
    loss, z = _best(remembering, power, worth, 0.3 * dt, dt)
    force = min(_best(partial(falling, order=p), power, worth, 0.5 / motion, dt)[0] for p in falls)
    if white - loss < BIC_GAIN or force - loss < BIC_GAIN:
        return None
    total = float(np.exp(z[0]) + np.exp(z[1]))
    return float(np.sqrt(total)), float(np.exp(z[1]) / total), float(np.exp(z[2]))


def _best(law: Law, power: Floats, worth: float, shortest: float, dt: float) -> tuple[float, Floats]:
    """Smallest negative log-likelihood of a law with three numbers, and these."""

    def loss(z: Floats) -> float:
        model = np.maximum(law(z), 1e-12 * power.max())
        return float(np.sum(np.log(model) + power / model)) * worth

    level, low = float(np.median(power[len(power) // 2 :])), float(np.mean(power[: max(len(power) // 8, 2)]))
    ends = [
        scipy.optimize.minimize(loss, [np.log(level), np.log(max(low, level)) + extra, np.log(max(tau * dt, shortest))],
                 method="Nelder-Mead", bounds=[(-40, 40), (-40, 60), (np.log(shortest), np.log(1e4 * dt + shortest))],
                 options={"maxiter": 600})
        for tau, extra in ((1.0, 0.0), (5.0, -2.0), (50.0, -4.0))
    ]  # fmt: skip
    best = min(ends, key=lambda e: float(e.fun))
    return float(best.fun), np.asarray(best.x)


def _stationary(problem: Problem, white: Floats) -> bool:
    """Whether the windows' sums of squares, made white, scatter as those of one noise do."""
    sums = np.add.reduceat(np.sum(white**2, axis=1), problem.rows[:-1]) / problem.counts
    spread = np.sqrt(2.0 / problem.counts)
    far = np.abs(sums / np.median(sums) - 1.0) > FAR * spread
    return bool(np.mean(far) < A_FEW)


def follows_input(problem: Problem, white: Floats) -> bool:
    """Whether any channel of a white residual (n, k) follows the inputs by more than chance."""
    past = _past(problem)
    past = past - past.mean(axis=0)
    rank = int(np.linalg.matrix_rank(past))
    free = len(past) - rank - 1
    if rank == 0 or free < 1:
        return False
    centred = white - white.mean(axis=0)
    told = past @ np.linalg.lstsq(past, centred, rcond=1e-10)[0]
    explained, whole = np.sum(told**2, axis=0), np.sum(centred**2, axis=0)
    ratio = (explained / rank) / np.maximum((whole - explained) / free, 1e-300)
    return bool(np.any(ratio > fisher.ppf(1.0 - BY_CHANCE, rank, free)))


def _past(problem: Problem) -> Floats:
    """Inputs of the last samples of each window and their squares with their sign: (n, 2 nu lags)."""
    scale = np.maximum(np.abs(problem.u).max(axis=0), 1e-300)
    first = np.repeat(problem.samples[problem.rows[:-1]], np.diff(problem.rows))  # of the window of each
    u = problem.u[np.maximum(problem.samples[:, None] - _LAGS, first[:, None])] / scale  # (n, lags, nu)
    return np.concatenate([u, np.abs(u) * u], axis=2).reshape(len(u), -1)


def memory_left(problem: Problem, found: Fit) -> tuple[int, ...]:
    """Channels whose misses correlate with themselves more than independent ones would by chance.

    Needs no size of the noise. Source: Ljung, Box (1978), Biometrika 65(2), of the pairs within windows. What the
    initial states took of white noise makes the rest correlate, many short windows by much: it is given back.
    """
    misses, states = state_columns(problem, found.theta, found.x0, state_steps(found.x0))
    own = [misses[a:b] for a, b in pairwise(problem.rows)]
    taken = [np.linalg.qr(states[:, a:b].reshape(len(states), -1).T)[0] for a, b in pairwise(problem.rows)]
    taken = [q.reshape(*miss.shape, -1) for q, miss in zip(taken, own, strict=True)]
    at_most = float(chi2.isf(BY_CHANCE / misses.shape[1], _ASKED))
    each = range(misses.shape[1])
    return tuple(k for k in each if _portmanteau([m[:, k] for m in own], [q[:, k] for q in taken]) > at_most)


def _portmanteau(own: Sequence[Floats], taken: Sequence[Floats]) -> float:
    """Sum over the lags of pairs times squared correlation: of independent misses chi^2, one for each lag.

    own: misses of each window (n,); taken: the directions that its initial state took, of length 1, (n, nx).
    """
    total, size = 0.0, float(np.mean(np.concatenate(own) ** 2))
    for lag in range(1, _ASKED + 1):
        pairs = np.concatenate([miss[:-lag] * miss[lag:] for miss in own])
        lost = size * sum(float(np.sum(q[:-lag] * q[lag:])) for q in taken)
        total += (float(np.sum(pairs)) + lost) ** 2 / max(pairs.size * size**2, 1e-300)
    return total
