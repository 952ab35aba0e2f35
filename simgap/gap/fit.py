"""The one entry of the gap stage: samples and settings in, a gap function and what is known about it out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Basis, make_basis
from simgap.gap.cell_fit import fit_blocks, fit_envelope
from simgap.gap.conformal import Calibration, fit_conformal
from simgap.gap.design import Design
from simgap.gap.forms import make_form, negated
from simgap.gap.function import GapFunction, GapSuprema
from simgap.gap.linear import LinearGap
from simgap.gap.lipschitz.compare import LipschitzRow, compare_estimates
from simgap.gap.lipschitz.grid import GridLipschitz, estimate
from simgap.gap.padding import SideFit, SideProblem, fit_side
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.gap.thresholds import GATE
from simgap.gap.tiers import Tier, deterministic_tier, estimate_tier
from simgap.geometry import Floats


@dataclass(frozen=True, eq=False)
class DimensionReport:
    """What is known about one dimension.

    Attributes:
        largest_gap: largest sampled |d|. sup: suprema over X x U. ratio: sup.size / largest_gap.
        lipschitz: grid estimate on d; estimates: it and the extreme-value estimates side by side.
        sides: fitted sides by name (`upper` and `lower`, or `both`), empty for bounds without a program.
        mean_size, mean_width: means of max(|lo|, |hi|) and of hi - lo over X x U, see `_means`.
    """

    state: str
    largest_gap: float
    sup: GapSuprema
    ratio: float
    mean_size: float
    mean_width: float
    lipschitz: GridLipschitz
    estimates: tuple[LipschitzRow, ...]
    sides: dict[str, SideFit]

    def to_json(self) -> dict[str, Any]:
        """Plain data for gap.json and the report."""
        sides = {
            name: {
                **s.scenario.to_json(), "padding": s.padding, "padding_mean": s.padding_mean, "raised": s.raised,
                "passes": s.passes, "lipschitz_of_basis": s.form.gradient_bound.tolist(), "rough_share": s.rough_share,
            }
            for name, s in self.sides.items()
        }  # fmt: skip
        return {
            "state": self.state, "largest_sampled_gap": self.largest_gap, "sup_size": self.sup.size,
            "sup_width": self.sup.width, "sup_over_largest_sample": self.ratio, "mean_size": self.mean_size,
            "mean_width": self.mean_width, "lipschitz": self.lipschitz.to_json(),
            "lipschitz_estimates": [row.to_json() for row in self.estimates], "scenario": sides,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class GapResult:
    """A fitted gap function with its reports, one for each dimension."""

    function: GapFunction
    dimensions: tuple[DimensionReport, ...]
    samples: int

    def to_json(self) -> dict[str, Any]:
        """The content of gap.json."""
        return {
            **self.function.to_json(),
            "samples": self.samples,
            "dimensions": [d.to_json() for d in self.dimensions],
        }


def fit_gap(samples: GapSamples, settings: GapSettings, calibration: Calibration | None = None) -> GapResult:
    """Fit the gap bound that the settings ask for; a conformal one needs `calibration`, iid samples of its own.

    Raises:
        UserError: for settings that do not fit the samples.
        BrokenPromise: when the grid does not resolve the gap, so that no Lipschitz constant can be trusted.
    """
    nx, free = len(samples.states), samples.free
    lipschitz = [estimate(samples.d[:, :, i], samples.grid, free, float(samples.rounding[i])) for i in range(nx)]
    sides: list[dict[str, SideFit]] = [{} for _ in range(nx)]
    if settings.bound == "conformal":
        function: GapFunction = fit_conformal(samples, settings, _basis(samples, settings), calibration)
    else:
        _gate(samples, settings, lipschitz)
        if settings.bound == "envelope":
            function = fit_envelope(samples, settings, lipschitz)
        elif settings.bound == "scenario" and settings.basis == "blocks":
            function = fit_blocks(samples, settings, lipschitz)
        else:
            function, sides = _fit_linear(samples, settings, lipschitz)
    reports = _reports(samples, settings, function, lipschitz, sides)
    return GapResult(function, reports, samples.d[:, :, 0].size)


def _basis(samples: GapSamples, settings: GapSettings) -> Basis:
    kind, options = settings.basis, dict(settings.basis_options)
    if settings.bound == "constant" or (settings.bound == "conformal" and kind == "blocks"):
        kind, options = "expressions", {"terms": ("1",)}
    basis = make_basis(kind, samples.states, samples.input_names, samples.grid.box, **options)
    for j in samples.free:
        for term, row in zip(basis.terms, basis.gradients, strict=True):
            if row[j] != 0:
                raise UserError(
                    f"the term '{term}' depends on {samples.states[j]}, along which a symmetry is declared",
                    key="gap.basis",
                    remedy="Leave it out, or withdraw the symmetry.",
                )
    return basis


def _gate(samples: GapSamples, settings: GapSettings, lipschitz: list[GridLipschitz]) -> None:
    """Refuse where the grid does not resolve the gap and the padding has no local jump bound for it."""
    local = settings.padding == "inflate" and settings.bound != "envelope"
    for name, found in zip(samples.states, lipschitz, strict=True):
        if local and found.rough_share <= settings.rough_limit:
            continue
        if local or not found.resolved:
            raise BrokenPromise(
                f"the gap of {name} is not Lipschitz at this grid: L(h/2)/L(h) = {found.ratio.max():.2f} > {GATE}, "
                f"{100 * found.rough_share:.2g} % of the cells are rough",
                "Use a smaller eps, or padding: inflate with a larger rough_limit if the jump is known.",
            )


def _fit_linear(
    samples: GapSamples, settings: GapSettings, lipschitz: list[GridLipschitz]
) -> tuple[LinearGap, list[dict[str, SideFit]]]:
    basis = _basis(samples, settings)
    design = Design(basis, samples.grid.centres(), samples.inputs)
    blank = make_form(basis, samples.grid.box, samples.inputs, np.zeros(basis.size))
    sides: list[dict[str, SideFit]] = []
    for i, found in enumerate(lipschitz):
        upper, lower = samples.side(i, upper=True), samples.side(i, upper=False)
        asked = {"upper": [upper], "lower": [lower]} if settings.signed else {"both": [upper, lower]}
        fits = {}
        for name, targets in asked.items():
            problem = SideProblem(design, targets, samples.grid, samples.free, float(samples.rounding[i]), blank)
            fits[name] = fit_side(problem, found, settings)
            if settings.padding == "inflate" and fits[name].rough_share > settings.rough_limit:
                raise BrokenPromise(
                    f"the residual of {samples.states[i]} is not Lipschitz at this grid: "
                    f"{100 * fits[name].rough_share:.2g} % of the cells are rough",
                    "Use a smaller eps, or a basis that follows the gap.",
                )
        sides.append(fits)
    tiers = _tiers(samples, settings, lipschitz, sides)
    if settings.signed:
        lows = tuple(negated(s["lower"].form) for s in sides)
        function = LinearGap(samples.domain, tiers, lows, tuple(s["upper"].form for s in sides))
    else:
        function = LinearGap.unsigned(samples.domain, tiers, [s["both"].form for s in sides])
    return _lifted(function), sides


def _lifted(function: LinearGap) -> LinearGap:
    """The bound moved outward until lo <= hi on all of X x U, verified by branch and bound, not at samples alone."""
    for _ in range(3):
        missing = 0.5 * np.maximum(-function.narrowest(), 0.0)
        if not missing.any():
            return function
        function = function.raised(missing * 1.000001, missing * 1.000001)
    raise BrokenPromise("the gap bound cannot be made wide enough to be never upside down")


def _tiers(
    samples: GapSamples, settings: GapSettings, lipschitz: list[GridLipschitz], sides: list[dict[str, SideFit]]
) -> tuple[Tier, ...]:
    rough = [max(s.rough_share for s in fits.values()) for fits in sides]
    used = [found.constants for found in lipschitz]
    extra = ""
    if settings.padding == "inflate":
        pads = "; ".join(
            f"{n}: {max(s.padding for s in f.values()):.3g}" for n, f in zip(samples.states, sides, strict=True)
        )
        extra = f"The padding uses the local slopes in each cell, less those of the fit; at most {pads}."
    return deterministic_tier(settings.padding), estimate_tier(samples.states, used, rough, extra)


def _reports(
    samples: GapSamples, settings: GapSettings, function: GapFunction, lipschitz: list[GridLipschitz],
    sides: list[dict[str, SideFit]],
) -> tuple[DimensionReport, ...]:  # fmt: skip
    suprema = function.sup()
    size, width = _means(samples, function, settings.seed)
    rng = np.random.default_rng(settings.seed)
    reports = []
    for i, state in enumerate(samples.states):
        largest = max(float(np.abs(samples.side(i, up)).max()) for up in (False, True))
        rows = compare_estimates(samples, i, lipschitz[i], settings, rng)
        ratio = suprema[state].size / largest if largest > 0.0 else float("inf")
        reports.append(
            DimensionReport(
                state, largest, suprema[state], ratio, float(size[i]), float(width[i]), lipschitz[i], rows, sides[i]
            )
        )
    return tuple(reports)


def _means(samples: GapSamples, function: GapFunction, seed: int, chunk: int = 200_000) -> tuple[Floats, Floats]:
    """(nx,), (nx,) means of max(|lo|, |hi|) and hi - lo over X x U: one random point of each cell for each input.

    Not at the samples: there an envelope has no width.
    """
    x, m, rng = samples.grid.centres(), len(samples.inputs), np.random.default_rng([seed, 1])
    size, width = np.zeros(len(samples.states)), np.zeros(len(samples.states))
    step = max(1, chunk // m)
    for a in range(0, len(x), step):
        part = np.repeat(x[a : a + step], m, axis=0)
        part += samples.grid.h * rng.uniform(-1.0, 1.0, part.shape)
        lo, hi = function.bounds(part, np.tile(samples.inputs, (len(part) // m, 1)))
        size += np.maximum(np.abs(lo), np.abs(hi)).sum(axis=0)
        width += (hi - lo).sum(axis=0)
    return size / (len(x) * m), width / (len(x) * m)
