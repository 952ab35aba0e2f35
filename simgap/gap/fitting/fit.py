"""From samples to a bound in one call, where nothing is kept between the steps: benchmarks, notebooks, tests."""

from __future__ import annotations

from simgap.config.gap import GapSection
from simgap.gap.fitting.bound_fit import GapResult, assemble, check_resolved, fit_dimension
from simgap.gap.fitting.dimension_fit import Calibration
from simgap.gap.lipschitz.estimates import dimension_lipschitz
from simgap.gap.sampling.samples import GapSamples


def fit_gap(samples: GapSamples, settings: GapSection, calibration: Calibration | None = None) -> GapResult:
    """Fit the bound that the settings ask for; a conformal one needs `calibration`, iid samples of its own.

    Raises:
        UserError: for settings that do not fit the samples.
        BrokenPromise: when the grid does not resolve the gap, so that no Lipschitz constant can be trusted.
    """
    parts = [samples.dimension(i) for i in range(len(samples.states))]
    lipschitz = [dimension_lipschitz(part, settings) for part in parts]
    check_resolved(samples.where, settings, lipschitz)
    fits = [fit_dimension(p, settings) for p in parts]
    return assemble(samples.where, settings, fits, lipschitz, calibration, samples.directed)
