"""Transitions over one sampling time, cut out of the windows of a diagnosis, and the windows as runs of a simulator.

A controller holds its command over the sampling time; a recording often has several commands in it. The model says what
such a change within the step did, and the measured end is freed of it, so that a transition is always one of a command
held at its mean. A velocity that was not measured is taken from its position by local cubics (Savitzky and Golay 1964):
an estimate, with the noise of the position that goes through the filter.

A run begins at the state that the corrected model gives for a time in a window. Its inputs are the recorded ones,
averaged over each sampling time, and over the delays of which a lag is a mixture; what was read is freed of what the
corrected model says of the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.late import scipy
from simgap.late import sympy as sp
from simgap.model.compile import compile_columns
from simgap.model.symbolic import SymbolicModel
from simgap.signals import savgol_coeffs, savgol_filter

_SPAN_S, _FEWEST, _ORDER = 0.05, 5, 3
_INNER, _MOST = 20, 1000
"""Steps of the integration within an interval of the recording, and the most within a transition."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Steps that do not overlap.

    Attributes:
        start: (n, states and inputs) where each begins, the states first; the inputs are means over the step.
        then: (n, k) what is measured a step later, under inputs held at these means.
        seconds: length of the step; pieces: into how many an integration takes it.
        trace: (n,) name of the recording that each is of; at: (n,) when it begins there, s.
    """

    start: Floats
    then: Floats
    seconds: float
    pieces: int
    trace: NDArray[np.str_]
    at: Floats


def seen(
    windows: Sequence[WindowPrediction], sigma: Mapping[str, float], model: SymbolicModel
) -> tuple[list[WindowPrediction], dict[str, float]]:
    """The windows laid together, with the velocities of coordinates whose position alone was measured; and the noise.

    Args:
        sigma: noise of each measured state, in the order of the columns; model: has the coordinates.
    """
    whole = joined(windows)
    missing = {c.velocity: c.position for c in model.coordinates if c.velocity not in sigma and c.position in sigma}
    steps = [np.diff(w.t) for w in whole]
    if not missing or not steps:
        return whole, dict(sigma)
    dt = float(np.median(np.concatenate(steps)))
    size = max(_FEWEST, 2 * round(0.5 * _SPAN_S / dt) + 1)
    through = float(np.linalg.norm(savgol_coeffs(size, _ORDER, deriv=1, delta=dt)))
    more = {velocity: through * sigma[position] for velocity, position in missing.items()}
    columns = [list(sigma).index(position) for position in missing.values()]
    long = [_with_velocities(w, columns, size, dt) for w in whole if len(w.t) > 2 * size]
    return long, dict(sigma) | more


def transitions(
    windows: Sequence[WindowPrediction], measured: Sequence[str], model: SymbolicModel, late: Mapping[str, float],
    step: float,
) -> Transitions:  # fmt: skip
    """Steps of `step` seconds in the windows of `seen`.

    They begin and end at readings that are measurements. A state that was not measured is what the corrected model
    makes of it; an input is its mean over the step, `late` seconds earlier. `model` says
    what commands that change within a step did.
    """
    names, nx = [*model.state_names, *model.input_names], len(model.state_names)
    rows = [(np.zeros((0, len(names))), np.zeros((0, len(measured))), np.zeros(0, dtype=str), np.zeros(0))]
    dt = [float(np.median(np.diff(w.t))) for w in windows]
    samples = int(np.ceil(step / min(dt) * (1 - 1e-9))) if dt else 1
    pieces = max(min(_INNER * samples, _MOST), samples)
    for w in windows:
        at = np.arange(w.t[0], w.t[-1] - step * (1 + 1e-9), step)
        sure = [np.interp(s, w.t, used) > 1.0 - 1e-9 for s in (at, at + step) for used in w.used.T]  # by measurements
        at = at[np.all(sure, axis=0)]
        own = np.full(len(at), w.trace)
        columns = {n: np.interp(at, w.t, w.states[:, i]) for i, n in enumerate(names[:nx])}
        columns |= {n: np.interp(at, w.t, w.measured[:, k]) for k, n in enumerate(measured)}
        columns |= {n: mean_input(w, j, at - late.get(n, 0.0), step) for j, n in enumerate(names[nx:])}
        start = np.stack([columns[n] for n in names], axis=1)
        then = np.stack([np.interp(at + step, w.t, w.measured[:, k]) for k in range(len(measured))], axis=1)
        if samples > 1 and len(at):
            true = _integrated(model, start[:, :nx], _commands(w, at, model, late), step, pieces)
            moved = true - held(model, Transitions(start, then, step, pieces, own, at))
            then = then - moved[:, [model.state_names.index(n) for n in measured]]
        rows.append((start, then, own, at))
    begin, end, traces, stamps = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    return Transitions(begin, end, step, pieces, traces, stamps)


def held(model: SymbolicModel, part: Transitions) -> Floats:
    """Where a model ends under inputs held at their means: (n, nx)."""
    nx = len(model.state_names)
    inputs = part.start[:, nx:].T
    return _integrated(model, part.start[:, :nx], lambda _, __: inputs, part.seconds, part.pieces)


def within(part: Transitions, model: SymbolicModel, X: Mapping[str, tuple[float, float]]) -> Transitions:
    """Those that begin in X and that the model keeps there, as a controller takes no others.

    States that are not named may be anything.
    """
    kept, end = np.ones(len(part.start), dtype=bool), held(model, part) if len(part.start) else part.start
    for name, (lo, hi) in X.items():
        for at in (part.start, end):
            column = at[:, model.state_names.index(name)]
            kept &= (column >= lo) & (column <= hi)
    rows = {n: getattr(part, n)[kept] for n in ("start", "then", "trace", "at")}
    return replace(part, **rows)


def force_ratio(
    model: SymbolicModel, part: Transitions, states: Sequence[str], declared: Mapping[str, float]
) -> Floats:
    """How far a force moves states under the known conditions of each transition, over the declared ones: (n, k).

    1 for states of no coordinate, and where nothing differs.
    """
    ratio = np.ones((len(part.start), len(states)))
    names = [*model.state_names, *model.input_names]
    if not declared or not len(part.start):
        return ratio
    as_declared = part.start.copy()
    for name, value in declared.items():
        as_declared[:, names.index(name)] = value
    for c in model.coordinates:
        row = model.state_names.index(c.velocity)
        exprs = [sp.sympify(column[row]).subs(model.values()) for column in model.force_map.values()]
        own, usual = (np.abs(compile_columns(exprs, names)(list(x.T))).sum(axis=0) for x in (part.start, as_declared))
        for k in (k for k, n in enumerate(states) if n in (c.position, c.velocity)):
            ratio[:, k] = own / usual
    return ratio


def mean_input(w: WindowPrediction, j: int, starts: Floats, step: float) -> Floats:
    """Mean of a held input over [start, start + step]; before the window its first value holds."""
    area = np.concatenate([[0.0], np.cumsum(w.inputs[:-1, j] * np.diff(w.t))])

    def integral(t: Floats) -> Floats:
        inside = np.interp(t, w.t, area)
        return inside + np.minimum(t - w.t[0], 0.0) * w.inputs[0, j] + np.maximum(t - w.t[-1], 0.0) * w.inputs[-1, j]

    return (integral(starts + step) - integral(starts)) / step


Commands = Callable[[float, float], Floats]
"""(seconds since the start, seconds) -> mean inputs of each transition over that piece, (m, n)."""


def _commands(w: WindowPrediction, at: Floats, model: SymbolicModel, late: Mapping[str, float]) -> Commands:
    """The inputs as they were recorded."""
    shift = [late.get(n, 0.0) for n in model.input_names]

    def mean(since: float, h: float) -> Floats:
        return np.reshape([mean_input(w, j, at - s + since, h) for j, s in enumerate(shift)], (len(shift), len(at)))

    return mean


def _integrated(model: SymbolicModel, x: Floats, commands: Commands, seconds: float, pieces: int) -> Floats:
    """States after some seconds in steps of the explicit midpoint: (n, nx) -> (n, nx)."""
    rate = compile_columns(list(model.numeric()), [*model.state_names, *model.input_names])
    x, h = x.T.copy(), seconds / pieces
    for k in range(pieces):
        u = commands(k * h, h)
        half = x + 0.5 * h * rate([*x, *u])
        x = x + h * rate([*half, *u])
    return x.T


def joined(windows: Sequence[WindowPrediction]) -> list[WindowPrediction]:
    """Neighbouring windows of a trace as one, in the order of time."""
    runs: list[list[WindowPrediction]] = []
    for w in sorted(windows, key=lambda w: (w.held_out, w.trace, float(w.t[0]))):
        last = runs[-1][-1] if runs else None
        near = last is not None and (last.held_out, last.trace) == (w.held_out, w.trace)
        if near and last is not None and 0.0 < w.t[0] - last.t[-1] <= 1.5 * float(np.median(np.diff(w.t))):
            runs[-1].append(w)
        else:
            runs.append([w])
    return [_one(run) for run in runs]


def _one(run: Sequence[WindowPrediction]) -> WindowPrediction:
    names = ("t", "measured", "before", "after", "states", "inputs", "used")
    whole = (np.concatenate([getattr(w, n) for w in run]) for n in names)
    return WindowPrediction(run[0].trace, run[0].held_out, *whole)


def _with_velocities(w: WindowPrediction, columns: Sequence[int], size: int, dt: float) -> WindowPrediction:
    """More measured columns; the ends, where a local cubic is one-sided, are cut off."""
    even = np.arange(w.t[0], w.t[-1], dt)
    slopes = [savgol_filter(np.interp(even, w.t, w.measured[:, k]), size, _ORDER, deriv=1, delta=dt) for k in columns]
    more = np.stack([np.interp(w.t, even, slope) for slope in slopes], axis=1)
    sound = scipy.ndimage.minimum_filter1d(w.used[:, columns], size, axis=0, mode="constant")  # all around are used
    whole = np.hstack([w.measured, more]), w.before, w.after, w.states, w.inputs, np.hstack([w.used, sound])
    inner = slice(size // 2, -(size // 2))
    rows = (a[inner] for a in (w.t, *whole))
    return WindowPrediction(w.trace, w.held_out, *rows)


@dataclass(frozen=True, eq=False)
class Followed:
    """One run.

    Attributes:
        start: (nx,) state at its begin; inputs: (k, m) held for a sampling time each.
        t: (n,) s since the start at which it is compared; read: (n, p) what the sensors say there, NaN if nothing.
    """

    start: Floats
    inputs: Floats
    t: Floats
    read: Floats


def followed(
    windows: Sequence[WindowPrediction], states: Sequence[str], inputs: Sequence[str], model_states: Sequence[str],
    measured: Sequence[str], late: Mapping[str, Sequence[float] | Floats], tau: float, since: float = 0.0,
) -> list[Followed]:  # fmt: skip
    """The windows as runs in steps of tau (s).

    Args:
        windows: of the diagnosis; model_states: names of the columns of their `states`.
        states, inputs: of the case, in order; measured: names of the columns of their `measured`.
        late: input -> seconds by which equal shares of it act later.
        since: s after the start of each window, before which inputs matter to what acts later; shorter ones are left.
    """
    place = [list(model_states).index(n) for n in states]
    seen = [list(model_states).index(n) for n in measured]
    runs = []
    for w in windows:
        begin = int(np.searchsorted(w.t, w.t[0] + since * (1 - 1e-9)))
        t = w.t[begin:] - w.t[min(begin, len(w.t) - 1)]
        steps = int(np.floor(t[-1] / tau * (1 + 1e-9))) if len(t) > 1 else 0
        if steps < 1:
            continue
        at = tau * np.arange(steps + 1, dtype=np.float64)
        begins = w.t[begin] + at[:-1]
        u = np.zeros((steps, len(inputs)))
        for k, n in enumerate(inputs):
            u[:, k] = np.mean([mean_input(w, k, begins - d, tau) for d in late.get(n, (0.0,))], axis=0)
        true = np.where(w.used > 0.0, w.measured - (w.after - w.states[:, seen]), np.nan)[begin:]
        if float(np.median(np.diff(t))) < tau:
            t, true = np.asarray(at), np.stack([np.interp(at, t, column) for column in true.T], axis=1)
        inside = t <= at[-1] * (1 + 1e-9)
        runs.append(Followed(w.states[begin, place], u, t[inside], true[inside]))
    return runs


def stray(runs: Sequence[Followed], paths: Sequence[Floats], seen: Sequence[int], sigma: Floats, tau: float) -> float:
    """Root mean square of what simulated paths miss, in standard deviations of the noise.

    Args:
        paths: of each run the states (k + 1, nx) at multiples of tau (s); seen: columns that were measured.
        sigma: (p,) noise of these.
    """
    squares = []
    for run, path in zip(runs, paths, strict=True):
        at = tau * np.arange(len(path))
        found = np.stack([np.interp(run.t, at, path[:, k]) for k in seen], axis=1)
        squares.append(np.square((found - run.read) / sigma))
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))
