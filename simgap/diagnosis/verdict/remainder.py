"""What is left after the correction, bounded from held-out transitions: a split-conformal one-step bound.

Score of a transition: `max_i |y_i(t + tau) - F_i(x(t), u)| / s_i`, with F the model integrated in fine steps, as the
simulator of a corrected case is (what the steps of the nominal map miss of that is in the gap already), and s_i the RMS
on the fitted transitions;
`split_conformal` says how far the held-out ones reach, near rest and in motion where these differ (`near_rest`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.diagnosis.reading.table import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.near_rest import NearRest, Scored, slow_and_fast
from simgap.diagnosis.verdict.transitions import Transitions, held, seen, transitions, within
from simgap.model.symbolic import SymbolicModel
from simgap.split_conformal import fewest, reach


@dataclass(frozen=True)
class Remainder:
    """One-step bounds of |measured - predicted|, by state.

    Attributes:
        tau: the step, s.
        level: coverage asked for; count: held-out transitions that set the bound.
        before, after: state -> bound under the declared and the corrected model; inf if there are too few transitions.
        rest_before, rest_after: where the velocity is small a wider bound stands beside these; None: nowhere.
        one_step: "before", "after", "noise_floor" -> state -> RMS of the one-step residual on held-out data; the floor
            is the noise of both ends.
        noise_only: state -> what the bound would be if measurement noise were all there is.
        inside: share of the held-out transitions inside the bound, for the corrected model.
        estimated: velocity that was derived from its position -> noise of the estimate.
        unbounded: states that were neither measured nor derived.
        statement: the coverage in words.
    """

    tau: float
    level: float
    count: int
    before: Mapping[str, float]
    after: Mapping[str, float]
    rest_before: NearRest | None
    rest_after: NearRest | None
    noise_only: Mapping[str, float]
    inside: float
    estimated: Mapping[str, float]
    unbounded: tuple[str, ...]
    statement: str
    one_step: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class _Bound:
    """Of one model: state -> bound, state -> RMS on held-out data, the bound near rest, scales (k,), share inside."""

    by: Mapping[str, float]
    rms: Mapping[str, float]
    rest: NearRest | None
    scale: Floats
    inside: float
    count: int


def bound_remainder(
    windows: Sequence[WindowPrediction],
    sigma: Mapping[str, float],
    models: tuple[SymbolicModel, SymbolicModel],
    shifts: Mapping[str, float],
    tau: float,
    level: float,
    X: Mapping[str, tuple[float, float]] | None = None,
) -> Remainder | None:
    """Bound the one-step residual from the windows that were held out.

    Args:
        windows: with measured channels, inputs, and the states that the corrected model gives where none was measured.
        sigma: noise of each measured state, in the order of the columns.
        models: declared and corrected, over the same states.
        shifts: seconds by which inputs act later in the corrected model.
        tau: sampling time, s; at least the interval of the data is used.
        level: coverage, such as 0.95.
        X: state -> where the bound is asked for; transitions that begin elsewhere do not count.

    Returns:
        None if nothing was held out, or no held-out window is longer than a step and begins in X.
    """
    known = seen(windows, sigma, models[1])
    kept, fitted = ([w for w in known.windows if w.held_out is out] for out in (True, False))
    if not kept:
        return None
    step = max(tau, float(np.median(np.concatenate([np.diff(w.t) for w in kept]))))
    names, bounds = list(known.sigma), []
    for model, late in zip(models, ({}, shifts), strict=True):
        parts = [within(transitions(ws, names, models[1], late, step), models[1], X or {}) for ws in (fitted, kept)]
        if not len(parts[1].start):
            return None
        bounds.append(_bound(model, (parts[0], parts[1]), names, level, X or {}))
    first, last = bounds
    noise = _noise_only(np.array(list(known.sigma.values())), last.scale, level)
    missing = tuple(n for n in models[0].state_names if n not in names)
    finite = all(math.isfinite(v) for v in last.by.values())
    statement = _statement(level, last.count, step, missing, finite)
    one_step = {
        "before": first.rms, "after": last.rms, "noise_floor": {n: math.sqrt(2.0) * s for n, s in known.sigma.items()}
    }  # fmt: skip
    return Remainder(
        step, level, last.count, first.by, last.by, first.rest, last.rest,
        dict(zip(names, noise.tolist(), strict=True)), last.inside, {n: known.sigma[n] for n in known.estimated},
        missing, statement + _derived(known.estimated) + (last.rest.words() if last.rest else ""), one_step,
    )  # fmt: skip


def _bound(
    model: SymbolicModel, parts: tuple[Transitions, Transitions], names: Sequence[str], level: float,
    X: Mapping[str, tuple[float, float]],
) -> _Bound:  # fmt: skip
    fitted, fresh = (_residuals(part, names, model) for part in parts)
    size = np.sqrt(np.mean((fitted if len(fitted) else fresh) ** 2, axis=0))
    scale = np.where(size > 0.0, size, 1.0)
    both = [
        Scored(np.max(np.abs(r) / scale, axis=1) if len(r) else np.zeros(0), _speeds(part, model))
        for r, part in zip((fitted, fresh), parts, strict=True)
    ]
    split = slow_and_fast(both[0], both[1], level, {n: 0.5 * (hi - lo) for n, (lo, hi) in X.items()})
    factor = reach(both[1].score, level) if split is None else split.fast
    by = dict(zip(names, (factor * scale).tolist(), strict=True))
    inside = both[1].score <= factor
    rest = None
    if split is not None:
        rest = NearRest(split.velocity, split.below, dict(zip(names, (split.slow * scale).tolist(), strict=True)))
        inside = np.where(both[1].slow(split.velocity, split.below), both[1].score <= split.slow, inside)
    rms = dict(zip(names, np.sqrt(np.mean(fresh**2, axis=0)).tolist(), strict=True))
    return _Bound(by, rms, rest, scale, float(np.mean(inside)), len(fresh))


def _speeds(part: Transitions, model: SymbolicModel) -> dict[str, Floats]:
    """Velocity of a coordinate -> its size at the start of each transition."""
    return {c.velocity: np.abs(part.start[:, model.state_names.index(c.velocity)]) for c in model.coordinates}


def _noise_only(sigma: Floats, scale: Floats, level: float) -> Floats:
    """The same bound for residuals that are the difference of two noisy readings and nothing else (seeded draws)."""
    draws = np.random.default_rng(0).standard_normal((20_000, len(sigma))) * np.sqrt(2.0) * sigma
    return scale * float(np.quantile(np.max(np.abs(draws) / scale, axis=1), level))


def _residuals(part: Transitions, names: Sequence[str], model: SymbolicModel) -> Floats:
    """Measured minus predicted one step later: (n, k)."""
    return part.then - held(model, part)[:, [model.state_names.index(n) for n in names]]


def _derived(names: Sequence[str]) -> str:
    if not names:
        return ""
    was = "was" if len(names) == 1 else "were"
    return f" {', '.join(names)} {was} derived from positions by local cubics, an estimate of what was not measured."


def _statement(level: float, count: int, step: float, missing: Sequence[str], enough: bool) -> str:
    if not enough:
        return f"{count} held-out transitions are too few for {100 * level:g} %: hold out at least {fewest(level)}."
    rest = f" {', '.join(missing)} was not measured and is not bounded." if missing else ""
    return (
        f"Split conformal: a further transition over {step:.4g} s, exchangeable with the {count:,} held-out ones, lies "
        f"within the bound of the model in all measured states at once with probability at least "
        f"{100 * level:g} %. Measurement noise is inside the bound. Transitions of one recording are not quite "
        f"exchangeable, and this is not a bound for every state.{rest}"
    )
