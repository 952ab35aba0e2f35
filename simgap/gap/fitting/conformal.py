"""Split conformal bound: covers a fresh random sample with a stated probability, and needs no Lipschitz constant.

A centre m(x, u) is fitted by least squares; the score of a calibration sample is `max_i |d_i - m_i| / scale_i`, and
`split_conformal` says how far such scores reach. It is a statement about a random state, not about every state: no
controller that is proved with it alone is safe for certain, and the tier says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.basis import Basis
from simgap.gap.bounds.linear import LinearGap
from simgap.gap.bounds.tiers import Tier
from simgap.gap.fitting.design import Design
from simgap.gap.fitting.linear_fit import basis_of, blank_form
from simgap.gap.json_record import JsonRecord
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import Centres, Combined
from simgap.gap.settings import GapSettings
from simgap.split_conformal import fewest, reach


@dataclass(frozen=True, eq=False)
class Calibration:
    """Fresh iid samples: x (n, nx), u (n, nu), d (n, nx)."""

    x: Floats
    u: Floats
    d: Floats


@dataclass(frozen=True, eq=False)
class CentreFit(
    JsonRecord,
    kind="centre",
    program="none: a conformal bound is a least-squares centre with a width from random samples",
):
    """Centre of one dimension, q.p by least squares, and its scale: root mean square of what it leaves (1 for 0)."""

    terms: tuple[str, ...]
    coefficients: Floats
    scale: float


def fit_centre(samples: DimensionSamples, settings: GapSettings) -> CentreFit:
    """The centre of one dimension from the grid samples (0 if unsigned).

    Raises:
        UserError: where hidden states spread the gap.
    """
    if samples.d_upper is not None:
        raise UserError(
            "a conformal bound does not cover a gap that hidden states of the simulator spread",
            key="gap.bound",
            remedy="Use scenario or envelope.",
        )
    basis = basis_of(samples.where, settings)
    design = Design(basis, Centres(samples.where.grid), samples.where.inputs)
    d = samples.side(upper=True)
    q = design.least_squares(d) if settings.signed else np.zeros(basis.size)
    squares = Combined(lambda own, fitted: (own - fitted) ** 2, (d, design.product(q)))
    scale = float(np.sqrt(squares.mean()))
    return CentreFit(basis.terms, q, scale if scale > 0.0 else 1.0)


def conformal_gap(
    where: SampleGrid, settings: GapSettings, fits: Sequence[CentreFit], calibration: Calibration | None
) -> LinearGap:
    """The width of all dimensions from the calibration samples.

    Raises:
        UserError: without calibration samples (those of a grid are not exchangeable with a random state, so none of
            them can stand in), or with too few for the miscoverage.
    """
    if calibration is None:
        raise UserError(
            "a conformal bound needs random samples of its own",
            key="gap.conformal",
            remedy="Make them with `simgap calibration` and give them to the gap stage as --calibration.",
        )
    blank = blank_form(Basis(fits[0].terms, where.states, where.input_names), where)
    forms = tuple(replace(blank, coefficients=fit.coefficients) for fit in fits)
    scale = np.array([fit.scale for fit in fits])
    centre = np.stack([f.values(calibration.x, calibration.u) for f in forms], axis=1)
    score = (np.abs(calibration.d - centre) / scale).max(axis=1)
    factor = reach(score, 1.0 - settings.miscoverage)
    if not np.isfinite(factor):
        raise UserError(
            f"{len(score)} calibration samples are too few for a miscoverage of {settings.miscoverage:g}",
            key="gap.conformal.miscoverage",
            remedy=f"Use at least {fewest(1.0 - settings.miscoverage)} samples.",
        )
    half = factor * scale + where.rounding / 16.0
    tier = _tier(settings, len(score))
    function = LinearGap(where.domain, (tier,), forms, tuple(replace(f) for f in forms))
    numerical = np.array([f.rounding for f in forms])
    return function.raised(half + numerical, half + numerical)


def _tier(settings: GapSettings, n: int) -> Tier:
    cover = f"{100 * (1.0 - settings.miscoverage):g} %"
    return Tier(
        3,
        "Split conformal: a random state and input drawn from the distribution of the calibration samples lies in the "
        f"bound with probability at least {cover} ({n:,} calibration samples, averaged over their draw). It is not a "
        "bound for every state.",
    )
