"""Split conformal bound: covers a fresh random sample with a stated probability, and needs no Lipschitz constant.

A centre m(x, u) is fitted by least squares; the score of a calibration sample is `max_i |d_i - m_i| / scale_i`, and
`split_conformal` says how far such scores reach. It is a statement about a random state, not about every state: no
controller that is proved with it alone is safe for certain, and the tier says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from simgap.errors import UserError
from simgap.gap.bases import Basis
from simgap.gap.design import Design
from simgap.gap.forms import make_form
from simgap.gap.linear import LinearGap
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.gap.tiers import Tier
from simgap.geometry import Floats
from simgap.split_conformal import fewest, reach


@dataclass(frozen=True, eq=False)
class Calibration:
    """Fresh iid samples: x (n, nx), u (n, nu), d (n, nx)."""

    x: Floats
    u: Floats
    d: Floats


def fit_conformal(
    samples: GapSamples, settings: GapSettings, basis: Basis, calibration: Calibration | None
) -> LinearGap:
    """Centre from the grid samples (0 if unsigned), width from the calibration samples.

    Raises:
        UserError: without calibration samples (those of a grid are not exchangeable with a random state, so none of
            them can stand in), with too few for the miscoverage, or where hidden states spread the gap.
    """
    if calibration is None:
        raise UserError(
            "a conformal bound needs random samples of its own",
            key="gap.conformal",
            remedy="Make them with `simgap calibration` and give them to the gap stage as --calibration.",
        )
    if samples.d_upper is not None:
        raise UserError(
            "a conformal bound does not cover a gap that hidden states of the simulator spread",
            key="gap.bound",
            remedy="Use scenario or envelope.",
        )
    design = Design(basis, samples.grid.centres(), samples.inputs)
    forms, scales = [], []
    for i in range(len(samples.states)):
        d = samples.side(i, upper=True)
        q = design.least_squares(d) if settings.signed else np.zeros(basis.size)
        scales.append(float(np.sqrt(np.mean((d - design.product(q)) ** 2))))
        forms.append(make_form(basis, samples.grid.box, samples.inputs, q))
    scale = np.where(np.array(scales) > 0.0, scales, 1.0)
    centre = np.stack([f.values(calibration.x, calibration.u) for f in forms], axis=1)
    score = (np.abs(calibration.d - centre) / scale).max(axis=1)
    factor = reach(score, 1.0 - settings.miscoverage)
    if not np.isfinite(factor):
        raise UserError(
            f"{len(score)} calibration samples are too few for a miscoverage of {settings.miscoverage:g}",
            key="gap.conformal.miscoverage",
            remedy=f"Use at least {fewest(1.0 - settings.miscoverage)} samples.",
        )
    half = factor * scale + samples.rounding / 16.0
    tier = _tier(settings, len(score))
    function = LinearGap(samples.domain, (tier,), tuple(forms), tuple(replace(f) for f in forms))
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
