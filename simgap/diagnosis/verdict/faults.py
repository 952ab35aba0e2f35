"""Faults of a recording, in words: what was found, by how much, and what to do."""

from __future__ import annotations

from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.simulation.problem import Problem


def noise_faults(problem: Problem) -> list[RecordingFault]:
    """What is to be said of a noise that remembers."""
    if problem.colour is None:
        return []
    found = []
    lasts = float(problem.t[problem.windows.stop[0] - 1] - problem.t[problem.windows.start[0]])
    for name, share, tau in zip(problem.model.measured, problem.colour.shared, problem.colour.tau, strict=True):
        if share == 0.0:
            continue
        what = f"{100 * share:.0f} % of the noise of {name} (its variance)"
        if tau > lasts:
            sentence = f"{what} wanders: a reading that drifts, slower than a window of {lasts:.2g} s."
            remedy = "Warm the sensor up, or zero it at a stop between runs."
            found.append(RecordingFault("drift", name, float(tau), "s", sentence, remedy))
            continue
        sentence = f"{what} is correlated over {1e3 * tau:.3g} ms; intervals and criteria count what is independent."
        remedy = f"Look for a filter, a slow sensor or an interpolation in the path of {name}; log its raw readings."
        found.append(RecordingFault("coloured_noise", name, float(tau), "s", sentence, remedy))
    return found
