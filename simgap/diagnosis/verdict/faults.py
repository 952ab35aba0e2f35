"""What a search says of faults of the recording: velocities to be left out, and noise that remembers."""

from __future__ import annotations

from simgap.diagnosis.record.faults.measurement import FilteredVelocity
from simgap.diagnosis.record.faults.noise import ColouredNoise, FaintMemory
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.problem import Problem


def filtered_channels(search: Search, found: Explanation) -> tuple[RecordingFault, ...]:
    """Velocities that were found to be filtered while their position is measured: they are left out from here on."""
    model = search.problem.model
    position = {c.velocity: c.position for c in model.model.coordinates}
    return tuple(
        c.effect.left_out(c.on, float(found.fit.theta[c.slots[0]]))
        for c in found.members
        if isinstance(c.effect, FilteredVelocity) and position[c.on] in model.measured
    )


def faint_memory(problem: Problem) -> tuple[str, ...]:
    """Channels of which a part of the noise alone remembers."""
    shares = () if problem.colour is None else zip(problem.model.measured, problem.colour.shared, strict=True)
    return tuple(name for name, share in shares if FaintMemory().is_in(float(share)))


def noise_faults(problem: Problem) -> list[RecordingFault]:
    """What is to be said of a noise that remembers."""
    if problem.colour is None:
        return []
    lasts = float(problem.t[problem.windows.stop[0] - 1] - problem.t[problem.windows.start[0]])
    shared, tau = (map(float, each) for each in (problem.colour.shared, problem.colour.tau))
    return ColouredNoise().of(zip(problem.model.measured, shared, tau, strict=True), lasts)
