"""Transitions over one sampling time, as the smoothed readings of a diagnosis tell them.

A controller holds its command over the sampling time; a recording often has several commands in it. The smoothed state
at the begin of a step, the model under the mean of the commands, and what the model misses in the step make a
transition of a command that is held. `smoothing` tells what is missed from the noise of the readings.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.missing import compiled
from simgap.diagnosis.verdict.smoothing import Plant, Stretch, missed_by
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

_INNER, _MOST = 8, 200
"""Steps of the integration within an interval of the recording, and the most within a transition."""
_STEPS, _ENDS = 20, 4
"""Steps that are smoothed together: what lasts is seen best, and an unstable plant stays near its path. Where there are
as many as the second, the first and the last are left out: nothing is read on one side of them."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Steps that do not overlap.

    Attributes:
        start: (n, states and inputs) where each begins, the states first; the inputs are means over the step.
        missed: (n, nx) what the model misses at the end, as far as the readings tell it; spread: its standard
            deviation; beyond: how much more it may be.
        seconds: length of the step; pieces: into how many an integration takes it.
        trace: (n,) name of the recording that each is of; at: (n,) when it begins there, s; held_out: (n,).
    """

    start: Floats
    missed: Floats
    spread: Floats
    beyond: Floats
    seconds: float
    pieces: int
    trace: NDArray[np.str_]
    at: Floats
    held_out: Bools


def known_states(model: SymbolicModel, measured: Sequence[str]) -> list[str]:
    """Those that are measured, and the velocities of coordinates whose position is."""
    derived = {c.velocity for c in model.coordinates if c.position in measured}
    return [n for n in model.state_names if n in measured or n in derived]


def transitions(
    windows: Sequence[WindowPrediction], sigma: Mapping[str, float], model: SymbolicModel, step: float, level: float,
) -> Transitions:  # fmt: skip
    """Steps of `step` seconds in the windows, smoothed together.

    Args:
        sigma: noise of each measured state, in the order of the columns.
        model: its delays act; what remembers earlier commands otherwise are states of it.
        level: of the interval at whose upper end the size of what is missed is taken.
    """
    whole = [w for w in _joined(windows) if w.t[-1] - w.t[0] >= step * (1 - 1e-9)]
    dt = min((float(np.median(np.diff(w.t))) for w in whole), default=step)
    pieces = min(max(_INNER * int(np.ceil(step / dt * (1 - 1e-9))), 2 * _INNER), _MOST)
    parts = [part for w in whole for part in _parts(w, step)]
    names, nx = [*model.state_names, *model.input_names], len(model.state_names)
    if not parts:
        empty = np.zeros((0, nx))
        return Transitions(
            np.zeros((0, len(names))),
            empty,
            empty,
            empty,
            step,
            pieces,
            np.zeros(0, str),
            np.zeros(0),
            np.zeros(0, bool),
        )
    plant = _plant(model, sigma, whole, step, max(count for _, _, count in parts), pieces)
    stretches = [_stretch(w, first, count, plant, model) for w, first, count in parts]
    found = missed_by(plant, stretches, level)
    inner = [range(1, count - 1) if count >= _ENDS else range(count) for _, _, count in parts]
    rows = [(k, m) for k, own in enumerate(inner) for m in own]
    k, m = np.array(rows).T
    means = np.stack([s.inputs.reshape(plant.steps, pieces, -1).mean(axis=1) for s in stretches])
    begins = np.array([parts[i][1] for i in k]) + step * m
    return Transitions(
        np.hstack([found.at[k, m], means[k, m]]), found.by[k, m], found.spread[k, m], found.beyond[k, m], step, pieces,
        np.array([parts[i][0].trace for i in k]), begins, np.array([parts[i][0].held_out for i in k]),
    )  # fmt: skip


def commands(
    windows: Sequence[WindowPrediction], part: Transitions, inputs: Sequence[str], late: Mapping[str, float]
) -> Floats:
    """Means of the recorded inputs over the transitions of these windows, each input by its seconds earlier: (n, m)."""
    found = np.zeros((len(part.at), len(inputs)))
    for w in _joined(windows):
        own = (part.trace == w.trace) & (part.at >= w.t[0]) & (part.at <= w.t[-1])
        for j, n in enumerate(inputs):
            found[own, j] = mean_input(w, j, part.at[own] - late.get(n, 0.0), part.seconds)
    return found


def _parts(w: WindowPrediction, step: float) -> list[tuple[WindowPrediction, float, int]]:
    """A window cut into stretches of nearly the same number of steps: (window, begin in s, steps)."""
    steps = int((w.t[-1] - w.t[0]) / step * (1 + 1e-9))
    edges = np.linspace(0, steps, -(-steps // _STEPS) + 1).astype(int)
    return [(w, float(w.t[0] + a * step), int(b - a)) for a, b in itertools.pairwise(edges)]


def _plant(
    model: SymbolicModel, sigma: Mapping[str, float], windows: Sequence[WindowPrediction], step: float, steps: int,
    pieces: int,
) -> Plant:  # fmt: skip
    names, known = list(model.state_names), known_states(model, list(sigma))
    kinematic = {c.position for c in model.coordinates}
    sizes = {n: 1e-3 * max(float(np.std(np.concatenate([w.states[:, i] for w in windows]))), 1e-9)
             for i, n in enumerate(names[: windows[0].states.shape[1]])}  # fmt: skip
    sizes |= {c.velocity: sigma[c.position] / step for c in model.coordinates if c.position in sigma} | dict(sigma)
    varied = np.array([sizes.get(n, 1e-3) for n in names])
    rate = compiled(list(model.numeric()), [*names, *model.input_names])
    moved = [names.index(n) for n in known if n not in kinematic]
    return Plant(
        rate, [names.index(n) for n in sigma], moved, np.array(list(sigma.values())), varied, step, steps, pieces
    )


def _stretch(w: WindowPrediction, first: float, count: int, plant: Plant, model: SymbolicModel) -> Stretch:
    inside = (w.t >= first - 1e-9) & (w.t <= first + count * plant.step * (1 + 1e-9))
    at = np.asarray(first + plant.step / plant.pieces * np.arange(plant.steps * plant.pieces, dtype=np.float64))
    late = [float(model.delays.get(n, 0.0)) for n in model.input_names]
    inputs = [mean_input(w, j, at - late[j], plant.step / plant.pieces) for j in range(len(late))]
    begin = int(np.argmax(inside))
    start = np.zeros(len(model.state_names))
    start[: w.states.shape[1]] = w.states[begin, : len(start)]
    for k, i in enumerate(plant.measured):
        start[i] = w.measured[begin, k]
    for i, n in enumerate(model.state_names):
        if i >= w.states.shape[1]:  # the output of a lag, near its command
            start[i] = inputs[model.input_names.index(n.removesuffix("_lagged"))][0]
    used = np.ones_like(w.measured) if w.used is None else w.used
    columns = np.stack(inputs, axis=1) if inputs else np.zeros((len(at), 0))
    return Stretch(w.t[inside] - first, w.measured[inside], used[inside], columns, start, w.held_out)


def held(model: SymbolicModel, part: Transitions) -> Floats:
    """Where a model ends under inputs held at their means: (n, nx)."""
    nx, h = len(model.state_names), part.seconds / part.pieces
    rate = compiled(list(model.numeric()), [*model.state_names, *model.input_names])
    x, u = part.start[:, :nx].T, part.start[:, nx:].T
    for _ in range(part.pieces):
        x = x + h * rate([*(x + 0.5 * h * rate([*x, *u])), *u])
    return x.T


def within(
    part: Transitions, model: SymbolicModel, X: Mapping[str, tuple[float, float]], held_out: bool | None = None
) -> Transitions:
    """Those that begin in X and that the model keeps there, as a controller takes no others; of one kind if asked.

    States that are not named may be anything.
    """
    kept = np.ones(len(part.start), dtype=bool) if held_out is None else part.held_out == held_out
    end = held(model, part) if len(part.start) else part.start
    for name, (lo, hi) in X.items():
        for at in (part.start, end):
            column = at[:, model.state_names.index(name)]
            kept &= (column >= lo) & (column <= hi)
    rows = {n: getattr(part, n)[kept] for n in ("start", "missed", "spread", "beyond", "trace", "at", "held_out")}
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
        own, usual = (np.abs(compiled(exprs, names)(list(x.T))).sum(axis=0) for x in (part.start, as_declared))
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


def _joined(windows: Sequence[WindowPrediction]) -> list[WindowPrediction]:
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
    if len(run) == 1:
        return run[0]
    names = ("t", "measured", "before", "after", "states", "inputs")
    t, read, before, after, states, inputs = (np.concatenate([getattr(w, n) for w in run]) for n in names)
    used = np.concatenate([np.ones_like(w.measured) if w.used is None else w.used for w in run])
    return replace(run[0], t=t, measured=read, before=before, after=after, states=states, inputs=inputs, used=used)
