"""One side of a linear bound: what the scenario program leaves, and the form that covers all of X x U."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.forms import Form
from simgap.gap.fitting.scenario import ScenarioResult
from simgap.gap.lipschitz.result import GridLipschitz
from simgap.gap.sampling.samples import SampleGrid


@dataclass(frozen=True, eq=False)
class SideFit:
    """What the scenario program of one side gave, before rounding and before a padding that is no part of it.

    Attributes:
        scenario: the last program.
        padding, padding_mean: largest and mean local padding over the cells where they are inside the program, else 0.
        missing: what q.p lacks to cover the (padded) targets at the samples.
        passes: programs solved. rough_share: cells with a jump, as far as the program looked for them.
        directed: samples on borders and beside switching surfaces that were covered, too. factor: by how many times
            what the slopes allow the residual rises from the centre of a cell to such a sample; at most 1 if they hold.
    """

    scenario: ScenarioResult
    padding: float
    padding_mean: float
    missing: float
    passes: int
    rough_share: float
    directed: int = 0
    factor: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        names = ("padding", "padding_mean", "missing", "passes", "rough_share", "directed", "factor")
        own = {name: getattr(self, name) for name in names}
        return {"coefficients": self.scenario.coefficients.tolist(), "program": self.scenario.to_json(), **own}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> SideFit:
        """The inverse of `to_json`."""
        scenario = ScenarioResult.from_json(data["program"], np.array(data["coefficients"], dtype=float))
        padding, mean, missing, rough = (float(data[k]) for k in ("padding", "padding_mean", "missing", "rough_share"))
        beside = int(data["directed"]), float(data["factor"])
        return SideFit(scenario, padding, mean, missing, int(data["passes"]), rough, *beside)


@dataclass(frozen=True, eq=False)
class PaddedSide:
    """One padded side: `form` covers its targets on all of X x U, given the Lipschitz constants.

    Attributes:
        fit: what it was made from. padding: largest local padding (inflate) or the constant (others); padding_mean: its
            mean over the cells. raised: constant added after the program: padding that is not in its constraint, worst
            violation and rounding. rough_share: cells with a jump.
    """

    form: Form
    fit: SideFit
    padding: float
    padding_mean: float
    raised: float
    rough_share: float

    def to_json(self) -> dict[str, Any]:
        """Numbers for gap.json and the report."""
        return {
            **self.fit.scenario.to_json(), "padding": self.padding, "padding_mean": self.padding_mean,
            "raised": self.raised, "passes": self.fit.passes, "lipschitz_of_basis": self.form.gradient_bound.tolist(),
            "rough_share": self.rough_share, "directed": self.fit.directed, "directed_factor": self.fit.factor,
        }  # fmt: skip


def with_coefficients(blank: Form, coefficients: Floats) -> Form:
    """q.p, q (z,), with the ranges that `blank` has of the basis."""
    return replace(blank, coefficients=coefficients)


def numerical(form: Form, floor: float) -> float:
    """Rounding of q.p at the samples and of the sampled gap itself."""
    return form.rounding + floor / 16.0


def padded(
    fit: SideFit, blank: Form, where: SampleGrid, floor: float, lipschitz: GridLipschitz, padding: str
) -> PaddedSide:
    """A side that covers X x U: `inflate` has its padding inside the program, the others take it from `lipschitz`.

    L1 is of the signed gap (L(|d|) <= L(d)) and an estimate; L2 of q.p is an analytic bound.
    """
    form, h = with_coefficients(blank, fit.scenario.coefficients), where.moving_half_widths
    if padding == "inflate":
        raised = fit.missing + numerical(form, floor)
        return PaddedSide(form.with_offset(raised), fit, fit.padding, fit.padding_mean, raised, fit.rough_share)
    if padding == "per_axis":
        reach = float((lipschitz.constants + form.gradient_bound) @ h)
    else:
        reach = float((lipschitz.euclidean + np.linalg.norm(form.gradient_bound)) * np.linalg.norm(h))
    raised = reach + fit.missing + numerical(form, floor)
    return PaddedSide(form.with_offset(raised), fit, reach, reach, raised, lipschitz.rough_share)
