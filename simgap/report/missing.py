"""What the equations of motion lack at each instant, for pictures: measured rates minus the model's, as forces.

Only for the eye. The fit never uses differentiated data, because such fits are biased on noisy records; a binned mean
over thousands of samples shows the shape of a missing term all the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.thresholds import SURE
from simgap.late import sympy as sp
from simgap.model.compile import compile_columns
from simgap.model.symbolic import SymbolicModel
from simgap.signals import savgol_coeffs, savgol_filter
from simgap.units import full_turn

SPAN_S, MIN_POINTS, BINS, ORDER = 0.08, 9, 24, 3
_MANY = 2.0  # turns


@dataclass(frozen=True, eq=False)
class Binned:
    """Mean of a missing term over bins of one regressor: centre, mean and its 95 % half-width, (bins,) each."""

    centre: Floats
    mean: Floats
    half: Floats


@dataclass(frozen=True, eq=False)
class Missing:
    """A missing term against its possible regressors.

    Attributes:
        label, unit: what lacks ('torque at the hinge') and its unit.
        before, after: for each regressor, the binned mean under the nominal and under the corrected model.
        units: unit of each regressor; folded: angles over many turns, which are shown within one.
    """

    label: str
    unit: str
    before: Mapping[str, Binned]
    after: Mapping[str, Binned]
    units: Mapping[str, str]
    folded: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class _Motion:
    """A trace on even stamps: smoothed states and inputs, and for each rate the raw channel that it is had from.

    `dt` is the spacing of the stamps, s. `channels` maps a state to (channel, how often that is differentiated to give
    the rate of the state).
    """

    t: Floats
    dt: float
    size: int
    values: Mapping[str, Floats]
    channels: Mapping[str, tuple[Floats, int]]


def missing_terms(
    record: Record, before: SymbolicModel, after: SymbolicModel, shifts: Mapping[str, float], sigma: Floats
) -> tuple[Missing, ...]:
    """The missing force on each coordinate, or the missing rate of each state of a plant without coordinates.

    Args:
        record: the data.
        before, after: nominal and corrected model over the same states (delays and lags left to `shifts`).
        shifts: seconds by which each input acts later in the corrected model.
        sigma: noise of each measured channel, (k,).

    Returns:
        nothing where a state can be had neither from its channel nor from a position's derivative.
    """
    motions = [m for trace in record.traces if (m := _motion(record, trace, before, sigma)) is not None]
    if not motions or any(n not in motions[0].values for n in before.state_names):
        return ()
    rows, labels, regressors = _rows(before)
    if not rows or any(r not in motions[0].channels for r in rows):
        return ()
    lacks = [
        np.concatenate([_lack(m, model, rows, moved) for m in motions], axis=1)
        for model, moved in ((before, {}), (after, shifts))
    ]
    columns = {n: np.concatenate([m.values[n] for m in motions]) for n in regressors}
    columns = {n: c for n, c in columns.items() if np.ptp(c) > 0.0}
    turns = {n: turn for n in columns if (turn := full_turn(before.units[n])) and np.ptp(columns[n]) > _MANY * turn}
    columns |= {n: columns[n] % turn for n, turn in turns.items()}  # what a motor does on each turn is seen there
    thin = max(1.0, SPAN_S / motions[0].dt)  # neighbours share a span: fewer are independent
    found = []
    for k, (label, unit, own) in enumerate(labels):
        old, new = ({n: _binned(c, lack[k], thin) for n, c in columns.items() if n in own} for lack in lacks)
        found.append(Missing(label, unit, old, new, before.units, frozenset(turns)))
    return tuple(found)


def _rows(model: SymbolicModel) -> tuple[list[str], list[tuple[str, str, set[str]]], list[str]]:
    """States whose rates are compared, what each comparison is called (label, unit, regressors), all regressors."""
    inputs = list(model.input_names)
    if model.coordinates:
        labels = [
            (f"{_force(c.force_unit)} at the {c.name}", c.force_unit, {c.position, c.velocity, *inputs})
            for c in model.coordinates
        ]
        return [c.velocity for c in model.coordinates], labels, [*model.state_names, *inputs]
    if model.wheels is not None:
        w = model.wheels
        turning, length = model.units[w.heading], model.units[w.x]
        names = (("forward speed", length), ("sideways speed", length), ("turning rate", turning))
        return [w.x, w.y, w.heading], [(n, f"{u}/s", set(inputs)) for n, u in names], inputs
    rows = [v for v, e in zip(model.states, model.xdot, strict=True) if not sp.sympify(e).is_Symbol]
    everything = [*model.state_names, *inputs]
    return [v.name for v in rows], [(f"rate of {v.name}", f"{v.unit}/s", set(everything)) for v in rows], everything


def _force(unit: str) -> str:
    return "torque" if "m" in unit.replace("*", " ").split() else "force"


def _motion(record: Record, trace: Trace, model: SymbolicModel, sigma: Floats) -> _Motion | None:
    """States and rates by local cubics over about 0.08 s (Savitzky & Golay 1964)."""
    dt = float(np.median(np.diff(trace.t)))
    size = max(MIN_POINTS, 2 * round(0.5 * SPAN_S / dt) + 1)
    t = np.arange(trace.t[0], trace.t[-1], dt)
    if t.size < 2 * size:
        return None
    values: dict[str, Floats] = {}
    channels: dict[str, tuple[Floats, int]] = {}
    for k, name in enumerate(record.measured):
        y = np.interp(t, trace.t, trace.y[:, k])
        values[name], channels[name] = savgol_filter(y, size, ORDER), (y, 1)
    slope, bend = (float(np.linalg.norm(savgol_coeffs(size, ORDER, deriv=d, delta=dt))) for d in (1, 2))
    noise = dict(zip(record.measured, sigma, strict=True))
    for c in model.coordinates:
        if c.position not in channels:
            continue
        y = channels[c.position][0]
        if c.velocity not in values:
            values[c.velocity] = savgol_filter(y, size, ORDER, deriv=1, delta=dt)
        if noise.get(c.velocity, np.inf) * slope > noise[c.position] * bend:  # the quieter way to an acceleration
            channels[c.velocity] = (y, 2)
    held = np.clip(np.searchsorted(trace.t, t, side="right") - 1, 0, len(trace.t) - 1)
    values |= {name: trace.u[held, j] for j, name in enumerate(record.inputs)}
    return _Motion(t, float(t[1] - t[0]), size, values, channels)


def _lack(motion: _Motion, model: SymbolicModel, rows: Sequence[str], shifts: Mapping[str, float]) -> Floats:
    """Measured minus modelled rates, turned into forces or the body frame: (rows, n).

    The modelled rate is integrated and taken off the channel before the filter differentiates: what the filter does to
    fast motion then falls on the small remainder alone.
    """
    values = dict(motion.values)
    for name, late in shifts.items():
        values[name] = np.interp(motion.t - late, motion.t, values[name])
    names = [*model.state_names, *model.input_names]
    exprs = dict(zip(model.state_names, model.numeric(), strict=True))
    arguments = [values[n] for n in names]
    ends = [np.append(v[1:], v[-1]) if n in model.state_names else v for n, v in zip(names, arguments, strict=True)]
    rates = compile_columns([exprs[r] for r in rows], names)
    modelled = 0.5 * (rates(arguments) + rates(ends))  # over each held input
    lack = np.empty_like(modelled)
    for i, r in enumerate(rows):
        channel, times = motion.channels[r]
        steps, whole = modelled[i][:-1], np.zeros_like(channel)
        for _ in range(times):
            whole = np.concatenate([[0.0], np.cumsum(steps)]) * motion.dt
            steps = 0.5 * (whole[1:] + whole[:-1])
        lack[i] = savgol_filter(channel - whole, motion.size, ORDER, deriv=times, delta=motion.dt)
    if model.coordinates:
        numbers = model.values()
        columns = [
            [sp.sympify(model.force_map[c.name][model.state_names.index(r)]).subs(numbers) for c in model.coordinates]
            for r in rows
        ]
        flat = compile_columns([e for row in columns for e in row], names)(arguments)
        inverse_mass = flat.reshape(len(rows), len(rows), -1).transpose(2, 0, 1)
        return np.asarray(np.linalg.solve(inverse_mass, lack.T[:, :, None])[:, :, 0].T)
    if model.wheels is not None:
        c, s = np.cos(values[model.wheels.heading]), np.sin(values[model.wheels.heading])
        return np.stack([c * lack[0] + s * lack[1], c * lack[1] - s * lack[0], lack[2]])
    return lack


def _binned(x: Floats, y: Floats, thin: float) -> Binned:
    """Means over bins of equal width (those with enough samples); `thin` samples count as one."""
    low, high = np.quantile(x, [0.005, 0.995])
    edges = np.linspace(float(low), float(high), BINS + 1)
    which = np.clip(np.digitize(x, edges) - 1, -1, BINS)
    inside = [y[which == b] for b in range(BINS)]
    rows = [
        (0.5 * (edges[b] + edges[b + 1]), np.mean(own), SURE * np.std(own) / np.sqrt(own.size / thin))
        for b, own in enumerate(inside)
        if own.size / thin >= 3.0
    ]
    return Binned(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)
