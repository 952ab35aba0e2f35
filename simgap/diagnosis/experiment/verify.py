"""What a wrong explanation would miss of a proposed recording: fitted to it in full, and not linearised."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.experiment.bench import Bench, Rival
from simgap.diagnosis.experiment.propose import Try
from simgap.diagnosis.search.fit import fit


def missed(bench: Bench, best: Try, rivals: Sequence[Rival], right: int, wrong: int) -> Floats:
    """Residuals over the noise, (n, k), of the wrong one on the recording to come alone, if the right one is right."""
    problem, x0 = bench.recorded(best.states[right], best.readings[right], best.u, whole=True)
    other = rivals[wrong]
    ends = fit(problem, other.theta, x0, other.slots, dict(zip(other.slots, other.steps, strict=True)))
    left = np.full_like(best.readings[right], np.nan)
    left[problem.samples] = problem.residuals(ends.theta, ends.x0) / np.sqrt(bench.excess)
    return left
