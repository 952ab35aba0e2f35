"""Recorded windows as runs that a simulator can follow, and how far it strays from them.

A run begins at the state that the corrected model gives for the start of a window. Its inputs are the recorded ones,
averaged over each sampling time; what was read is freed of what the corrected model says of the sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.transitions import mean_input


@dataclass(frozen=True, eq=False)
class Followed:
    """One run.

    Attributes:
        start: (nx,) state at its begin; inputs: (k, m) held for a sampling time each.
        t: (n,) s since the start at which it is compared; read: (n, p) what the sensors say there.
    """

    start: Floats
    inputs: Floats
    t: Floats
    read: Floats


def followed(
    windows: Sequence[WindowPrediction], states: Sequence[str], inputs: Sequence[str], model_states: Sequence[str],
    measured: Sequence[str], late: Mapping[str, float], tau: float,
) -> list[Followed]:  # fmt: skip
    """The windows as runs in steps of tau (s).

    Args:
        windows: of the diagnosis; model_states: names of the columns of their `states`.
        states, inputs: of the case, in order; measured: names of the columns of their `measured`.
        late: seconds by which an input acts later.
    """
    place = [list(model_states).index(n) for n in states]
    seen = [list(model_states).index(n) for n in measured]
    runs = []
    for w in windows:
        t = w.t - w.t[0]
        steps = int(np.floor(t[-1] / tau * (1 + 1e-9)))
        if steps < 1:
            continue
        at = tau * np.arange(steps + 1, dtype=np.float64)
        begins = w.t[0] + at[:-1]
        u = np.zeros((steps, len(inputs)))
        for k, n in enumerate(inputs):
            u[:, k] = mean_input(w, k, begins - late.get(n, 0.0), tau)
        true = w.measured - (w.after - w.states[:, seen])
        if float(np.median(np.diff(t))) < tau:
            read = np.stack([np.interp(at, t, column) for column in true.T], axis=1)
            runs.append(Followed(w.states[0, place], u, np.asarray(at), read))
        else:
            inside = t <= at[-1] * (1 + 1e-9)
            runs.append(Followed(w.states[0, place], u, t[inside], true[inside]))
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
    return float(np.sqrt(np.mean(np.concatenate(squares))))
