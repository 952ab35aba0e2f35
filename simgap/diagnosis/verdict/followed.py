"""Recorded windows as runs that a simulator can follow, and how far it strays from them.

A run begins at the state that the corrected model gives for a time in a window. Its inputs are the recorded ones,
averaged over each sampling time, and over the delays of which a lag is a mixture; what was read is freed of what the
corrected model says of the sensors.
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
        if len(t) < 2:
            continue
        steps = int(np.floor(t[-1] / tau * (1 + 1e-9)))
        if steps < 1:
            continue
        at = tau * np.arange(steps + 1, dtype=np.float64)
        begins = w.t[begin] + at[:-1]
        u = np.zeros((steps, len(inputs)))
        for k, n in enumerate(inputs):
            u[:, k] = np.mean([mean_input(w, k, begins - d, tau) for d in late.get(n, (0.0,))], axis=0)
        true = (w.measured - (w.after - w.states[:, seen]))[begin:]
        if float(np.median(np.diff(t))) < tau:
            read = np.stack([np.interp(at, t, column) for column in true.T], axis=1)
            runs.append(Followed(w.states[begin, place], u, np.asarray(at), read))
        else:
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
    return float(np.sqrt(np.mean(np.concatenate(squares))))
