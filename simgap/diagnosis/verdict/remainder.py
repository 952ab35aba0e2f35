"""What is left after the correction, bounded from held-out transitions: a split-conformal one-step bound.

Score of a transition: `max_i |y_i(t + tau) - f_i(x(t), u)| / s_i`, with s_i the RMS on the fitted transitions;
`split_conformal` says how far the held-out ones reach.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from simgap.diagnosis.reading.table import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.missing import evaluate
from simgap.model.integrators import discretise
from simgap.model.symbolic import SymbolicModel
from simgap.split_conformal import fewest, reach


@dataclass(frozen=True)
class Remainder:
    """One-step bounds of |measured - predicted|, by state.

    Attributes:
        tau: the step, s; integrator: how f was discretised.
        level: coverage asked for; count: held-out transitions that set the bound.
        before, after: state -> bound under the declared and the corrected model; inf if there are too few transitions.
        one_step: "before", "after", "noise_floor" -> state -> RMS of the one-step residual on held-out data; the floor
            is the noise of both ends.
        noise_only: state -> what the bound would be if measurement noise were all there is.
        inside: share of the held-out transitions inside the bound, for the corrected model.
        unbounded: states that were not measured.
        statement: the coverage in words.
    """

    tau: float
    integrator: str
    level: float
    count: int
    before: Mapping[str, float]
    after: Mapping[str, float]
    noise_only: Mapping[str, float]
    inside: float
    unbounded: tuple[str, ...]
    statement: str
    one_step: Mapping[str, Mapping[str, float]]


def bound_remainder(
    windows: Sequence[WindowPrediction],
    sigma: Mapping[str, float],
    models: tuple[SymbolicModel, SymbolicModel],
    shifts: Mapping[str, float],
    tau: float,
    integrator: str,
    level: float,
) -> Remainder | None:
    """Bound the one-step residual from the windows that were held out.

    Args:
        windows: with measured channels, inputs, and the states that the corrected model gives where none was measured.
        sigma: noise of each measured state, in the order of the columns.
        models: declared and corrected, over the same states.
        shifts: seconds by which inputs act later in the corrected model.
        tau: sampling time, s; at least the interval of the data is used.
        integrator: of f.
        level: coverage, such as 0.95.

    Returns:
        None if nothing was held out, or no held-out window is longer than a step.
    """
    held, measured = [w for w in windows if w.held_out], list(sigma)
    if not held:
        return None
    step = max(tau, float(np.median(np.concatenate([np.diff(w.t) for w in held]))))
    scale, scores, errors = [], [], []
    for model, late in zip(models, ({}, shifts), strict=True):
        f = discretise(model, step, integrator)
        fitted = _residuals([w for w in windows if not w.held_out], measured, model, f, late, step)
        fresh = _residuals(held, measured, model, f, late, step)
        if not len(fresh):
            return None
        size = np.sqrt(np.mean((fitted if len(fitted) else fresh) ** 2, axis=0))
        scale.append(np.where(size > 0.0, size, 1.0))
        errors.append(dict(zip(measured, np.sqrt(np.mean(fresh**2, axis=0)).tolist(), strict=True)))
        scores.append(np.max(np.abs(fresh) / scale[-1], axis=1))
    count = len(scores[0])
    factors = [reach(s, level) for s in scores]
    bounds = [{n: float(r * s[k]) for k, n in enumerate(measured)} for r, s in zip(factors, scale, strict=True)]
    noise = _noise_only(np.array(list(sigma.values())), scale[1], level)
    inside = float(np.mean(scores[1] <= factors[1]))
    missing = tuple(n for n in models[0].state_names if n not in measured)
    statement = _statement(level, count, step, integrator, missing, math.isfinite(factors[1]))
    alone = dict(zip(measured, noise.tolist(), strict=True))
    floor = {name: math.sqrt(2.0) * value for name, value in sigma.items()}
    one_step = {"before": errors[0], "after": errors[1], "noise_floor": floor}
    return Remainder(step, integrator, level, count, bounds[0], bounds[1], alone, inside, missing, statement, one_step)


def _noise_only(sigma: Floats, scale: Floats, level: float) -> Floats:
    """The same bound for residuals that are the difference of two noisy readings and nothing else (seeded draws)."""
    draws = np.random.default_rng(0).standard_normal((20_000, len(sigma))) * np.sqrt(2.0) * sigma
    return scale * float(np.quantile(np.max(np.abs(draws) / scale, axis=1), level))


def _residuals(
    windows: Sequence[WindowPrediction],
    measured: Sequence[str],
    model: SymbolicModel,
    f: Sequence[sp.Expr],
    late: Mapping[str, float],
    step: float,
) -> Floats:
    """Measured minus predicted one step later, over transitions that do not overlap: (n, k)."""
    names = [*model.state_names, *model.input_names]
    wanted = [f[model.state_names.index(n)] for n in measured]
    start, then = transitions(windows, measured, names, late, step)
    return then - evaluate(wanted, names, list(start.T)).T


def transitions(
    windows: Sequence[WindowPrediction], measured: Sequence[str], names: Sequence[str], late: Mapping[str, float],
    step: float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Where transitions that do not overlap begin, and what is measured a step later.

    -> (n, states and inputs) in the order of `names`, the states first; (n, k). A state that was not measured is what
    the corrected model makes of it; an input is its mean over the step, `late` seconds earlier.
    """
    begin, end = [np.zeros((0, len(names)))], [np.zeros((0, len(measured)))]
    for w in windows:
        starts = np.arange(w.t[0], w.t[-1] - step * (1 + 1e-9), step)
        nx = w.states.shape[1]
        columns = {n: np.interp(starts, w.t, w.states[:, i]) for i, n in enumerate(names[:nx])}
        columns |= {n: np.interp(starts, w.t, w.measured[:, k]) for k, n in enumerate(measured)}
        columns |= {n: mean_input(w, j, starts - late.get(n, 0.0), step) for j, n in enumerate(names[nx:])}
        begin.append(np.stack([columns[n] for n in names], axis=1))
        end.append(np.stack([np.interp(starts + step, w.t, w.measured[:, k]) for k in range(len(measured))], axis=1))
    return np.concatenate(begin), np.concatenate(end)


def mean_input(w: WindowPrediction, j: int, starts: Floats, step: float) -> Floats:
    """Mean of a held input over [start, start + step]; before the window its first value holds."""
    area = np.concatenate([[0.0], np.cumsum(w.inputs[:-1, j] * np.diff(w.t))])

    def integral(t: Floats) -> Floats:
        inside = np.interp(t, w.t, area)
        return inside + np.minimum(t - w.t[0], 0.0) * w.inputs[0, j] + np.maximum(t - w.t[-1], 0.0) * w.inputs[-1, j]

    return (integral(starts + step) - integral(starts)) / step


def _statement(level: float, count: int, step: float, integrator: str, missing: Sequence[str], enough: bool) -> str:
    if not enough:
        return f"{count} held-out transitions are too few for {100 * level:g} %: hold out at least {fewest(level)}."
    rest = f" {', '.join(missing)} was not measured and is not bounded." if missing else ""
    return (
        f"Split conformal: a further transition over {step:.4g} s, exchangeable with the {count:,} held-out ones, lies "
        f"within the bound of the model ({integrator}) in all measured states at once with probability at least "
        f"{100 * level:g} %. Measurement noise is inside the bound. Transitions of one recording are not quite "
        f"exchangeable, and this is not a bound for every state.{rest}"
    )
