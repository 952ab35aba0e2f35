"""Acceptance of a gap bound: fresh samples against it, its worst violation, and the remedy where a grid is too coarse.

Fresh samples are used in no fit; their violations give a Clopper-Pearson bound of the probability of one. Samples on
borders of X and beside switching surfaces are directed: one violation there refuses the bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.config.gap import GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Blocks
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapFunction, Tier
from simgap.gap.lipschitz.grid import GridLipschitz
from simgap.gap.sampling.samples import SampleGrid
from simgap.gap.thresholds import GATE
from simgap.late import scipy


@dataclass(frozen=True)
class Outside:
    """One gap that its bound does not cover.

    Attributes:
        state: whose gap it is. excess: by how much it lies outside, in the unit of the state.
        gap: simulator minus model there; lower, upper: the bound there.
        at: value of each state and input there.
    """

    state: str
    excess: float
    gap: float
    lower: float
    upper: float
    at: dict[str, float]

    def __str__(self) -> str:
        """In words for a message."""
        place = ", ".join(f"{name} = {value:.4g}" for name, value in self.at.items())
        return (
            f"the worst in {self.state} at {place}, where the gap is {self.gap:.4g} and gamma "
            f"[{self.lower:.4g}, {self.upper:.4g}], by {self.excess:.2g}"
        )


def worst_outside(
    names: tuple[Sequence[str], Sequence[str]], x: Floats, u: Floats, d: tuple[Floats, Floats], lo: Floats, hi: Floats
) -> Outside | None:
    """The gap that lies outside by the largest share of its bound's width; None if all lie inside.

    Args:
        names: of states and inputs.
        x, u: (n, nx), (n, nu) places. d: least and largest gap there, (n, nx) each. lo, hi: (n, nx) the bound there.
    """
    below, above = lo - d[0], d[1] - hi
    excess = np.maximum(below, above)
    if not (excess > 0.0).any():
        return None
    share = np.where(excess > 0.0, excess / np.maximum(hi - lo, np.finfo(float).tiny), -np.inf)
    k, i = (int(index) for index in np.unravel_index(int(np.argmax(share)), share.shape))
    gap = d[0][k, i] if below[k, i] >= above[k, i] else d[1][k, i]
    at = dict(zip((*names[0], *names[1]), map(float, (*x[k], *u[k])), strict=True))
    return Outside(names[0][i], float(excess[k, i]), float(gap), float(lo[k, i]), float(hi[k, i]), at)


def clopper_pearson_upper(n: int, violations: int, confidence: float = 0.95) -> float:
    """One-sided upper bound of a probability from `violations` among `n` iid trials (Clopper & Pearson 1934).

    Raises:
        UserError: for counts that cannot be.
    """
    if n < 1 or not 0 <= violations <= n:
        raise UserError(f"{violations} violations among {n} samples cannot be")
    return 1.0 if violations == n else float(scipy.special.betaincinv(violations + 1, n - violations, confidence))


@dataclass(frozen=True)
class FreshCheck:
    """A gap bound checked against samples that no fit has seen.

    Attributes:
        samples, violations: independent trials, and those that violate in at least one dimension: rows, or whole
            sequences of steps where a simulator remembers; `steps` is then how many steps they have together.
        by_state: violations for each state; worst: largest excess over the bound for each state, 0 if none.
        upper, confidence: the violation probability is at most `upper` with this confidence.
        outside: the worst violating row, None if there is none.
    """

    samples: int
    violations: int
    by_state: dict[str, int]
    worst: dict[str, float]
    upper: float
    confidence: float
    steps: int | None = None
    outside: Outside | None = None

    @property
    def tier(self) -> Tier:
        """The statistical statement."""
        percent = f"{100 * self.confidence:g} %"
        if self.steps is not None:
            return Tier(
                3,
                f"Checked on {self.samples:,} fresh random sequences ({self.steps:,} steps in all): "
                f"{self.violations} of them with a step outside; the probability that a sequence has one is at most "
                f"{self.upper:.2g} with {percent} confidence (Clopper-Pearson; sequences are independent, their steps "
                "are not).",
            )
        return Tier(
            3,
            f"Checked on {self.samples:,} fresh random off-grid samples: {self.violations} violations; "
            f"the probability of one is at most {self.upper:.2g} with {percent} confidence (Clopper-Pearson).",
        )


@dataclass(frozen=True)
class BorderCheck:
    """A bound checked against samples on the border of X and on both sides of switching surfaces: directed, not random.

    Attributes:
        samples, violations: pairs of a state and an input, and those that violate in at least one dimension.
        surfaces: switching surfaces of the case. worst: largest excess over the bound for each state, 0 if none.
        outside: the worst of all, None if there is none.
    """

    samples: int
    violations: int
    surfaces: int
    worst: dict[str, float]
    outside: Outside | None = None

    @property
    def tier(self) -> Tier:
        """The count; it is no part of the statistical statement."""
        surfaces = f" and on both sides of {self.surfaces} declared switching surfaces" if self.surfaces else ""
        return Tier(
            3,
            f"Also checked on {self.samples:,} samples on faces, edges and corners of X{surfaces}: "
            f"{self.violations} outside. These samples are directed, not random, and do not count in that probability.",
        )


def check_fresh(
    function: GapFunction, x: Floats, u: Floats, d: Floats, confidence: float = 0.95, d_upper: Floats | None = None
) -> FreshCheck:
    """Count violations of lo <= d <= hi: (n, nx), (n, nu), (n, nx); `d_upper` where hidden states spread the gap.

    Raises:
        UserError: samples outside of X x U, where there is no bound that they could confirm.
    """
    lo, hi = function.bounds(x, u)
    unbounded = int((~np.isfinite(lo) | ~np.isfinite(hi)).any(axis=1).sum())
    if unbounded:
        raise UserError(
            f"{unbounded} of {len(x)} samples lie outside the X or U of the bound: they say nothing of it",
            remedy="Run `fresh` again.",
        )
    top = d if d_upper is None else d_upper
    excess = np.maximum(lo - d, top - hi)
    bad = ~(excess <= 0.0)
    rows = bad.any(axis=1)
    states = function.domain.states
    count = int(rows.sum())
    return FreshCheck(
        len(x),
        count,
        {s: int(bad[:, i].sum()) for i, s in enumerate(states)},
        {s: float(max(excess[:, i].max(initial=0.0), 0.0)) for i, s in enumerate(states)},
        clopper_pearson_upper(len(x), count, confidence),
        confidence,
        outside=worst_outside((states, function.domain.inputs), x, u, (d, top), lo, hi),
    )


def check_sequences(
    excess: Floats, path: Floats, begins: Ints, states: Sequence[str], confidence: float = 0.95
) -> FreshCheck:
    """Count sequences with any step outside.

    Args:
        excess: (n, nx) by how much each step's gap lies outside, negative inside; path: (n,) the same of its path.
        begins: rows at which a sequence begins, the first of them 0.
        states: names.
        confidence: of the Clopper-Pearson bound.
    """
    bad = ~((excess <= 0.0).all(axis=1) & (path <= 0.0))
    failed = int(np.logical_or.reduceat(bad, begins).sum())
    worst = {s: float(max(excess[:, i].max(), 0.0)) for i, s in enumerate(states)}
    return FreshCheck(
        len(begins), failed, {s: int((excess[:, i] > 0).sum()) for i, s in enumerate(states)},
        worst | ({"path": float(path.max())} if (path > 0).any() else {}),
        clopper_pearson_upper(len(begins), failed, confidence), confidence, steps=len(excess),
    )  # fmt: skip


def tolerate(check: FreshCheck, probability: float, remedy: str) -> None:
    """One violation breaks the promise, unless the case tolerates a probability that the check confirms.

    Raises:
        BrokenPromise: with the count and the largest excess.
    """
    if check.violations == 0 or check.upper <= probability:
        return
    allowed = "none is tolerated" if probability == 0 else f"tolerated probability {probability:g} < {check.upper:.2g}"
    raise BrokenPromise(
        f"gamma does not cover: {check.violations:,} of {check.samples:,} fresh samples exceed it ({allowed}), "
        f"{_where(check)}",
        remedy,
    )


def _where(check: FreshCheck | BorderCheck) -> str:
    """The worst place, where one is known: of sequences of steps it is not kept."""
    if check.outside is not None:
        return str(check.outside)
    return "by up to " + ", ".join(f"{value:.3g} in {name}" for name, value in check.worst.items() if value > 0.0)


def none_outside(check: BorderCheck) -> None:
    """On borders and beside switching surfaces nothing is tolerated: these samples are not random.

    Raises:
        BrokenPromise: with the count and the largest excess.
    """
    if check.violations:
        raise BrokenPromise(
            f"gamma does not cover: {check.violations} of {check.samples} samples on borders of X and beside switching "
            f"surfaces exceed it, {_where(check)}",
            "Use a finer grid: a smaller grid.eps, or grid.half_widths of the state that the gap bends along (`simgap "
            "refine` says which).",
        )


def confirmed(tiers: Sequence[Tier], check: FreshCheck) -> list[Tier]:
    """The tiers that fresh samples leave standing: none of them says "every state" beside a violation."""
    if check.violations == 0:
        return list(tiers)
    by, worst = _sizes({name: value for name, value in check.worst.items() if value > 0}), str(check.outside or "")
    broken = Tier(
        2,
        f"The bound does not hold at every state: {check.violations:,} of {check.samples:,} fresh samples exceed it, "
        f"by up to {by}; the case tolerates that." + (f" {worst[:1].upper()}{worst[1:]}." if worst else ""),
    )
    return [broken, *(tier for tier in tiers if tier.level != 1)]


def covering_remainder(function: GapFunction, section: GapSection) -> GapFunction:
    """The bound moved outward by what measured data leave unexplained in one step, further within given boxes.

    Raises:
        UserError: a remainder of something that is no state.
    """
    states = function.domain.states
    for key, names in _named(section):
        unknown = [name for name in names if name not in states]
        if unknown:
            raise UserError(f"{unknown} are not states", key=key)
    remainder, boxes = section.remainder, section.remainder_within
    if not remainder and not boxes:
        return function
    by = np.array([remainder.get(name, 0.0) for name in states])
    covering, words = function, f"Raised on both sides by {_sizes(remainder)}" if remainder else "Raised on both sides"
    for box in boxes:
        more = np.maximum(np.array([box.by.get(name, 0.0) for name in states]) - by, 0.0)
        if isinstance(covering, CellGap):
            covering = covering.raised_within(box.where, more)
            ends = " and ".join(f"{name} in [{lo:.3g}, {hi:.3g}]" for name, (lo, hi) in box.where.items())
            words += f"{',' if remainder else ''} by {_sizes(box.by)} in the cells with {ends}"
        else:
            by = by + more
            words += f" and, as the bound is not a table of cells, by {_sizes(box.by)} everywhere"
    left_out = [name for name in states if name not in remainder and not any(name in box.by for box in boxes)]
    note = f" Nothing measured bounds {', '.join(left_out)}." if left_out else ""
    tier = Tier(3, f"{words}: the split-conformal bound of what measured data leave.{note}")
    return covering.raised(by, by).with_tiers([*function.tiers, tier])


def _named(section: GapSection) -> Iterator[tuple[str, Iterable[str]]]:
    yield "gap.remainder", section.remainder
    for k, box in enumerate(section.remainder_within):
        yield f"gap.remainder_within.{k}.where", box.where
        yield f"gap.remainder_within.{k}.by", box.by


def _sizes(by: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3g} for {name}" for name, value in by.items())


def remedy(where: SampleGrid, settings: GapSection, found: GridLipschitz, share: float, residual: bool = False) -> str:
    """More samples; or, where something switches, a model that does the same, or a bound that takes the jump in.

    Args:
        where, settings: of the bound. found: what is known of the gap.
        share: of the cells that are rough. residual: whether in what the basis leaves.
    """
    if not found.layers:
        if residual:
            return "Use a smaller eps, or a basis that follows the gap."
        return f"Use {_finer(where, found)}, or padding: inflate with a larger rough_limit if a jump is known."
    local = "" if settings.padding == "inflate" else "padding: inflate and "
    limit = min(1.0, 0.05 * np.ceil(20.0 * share + 0.2))
    table = "" if isinstance(settings.basis, Blocks) else " with gap.basis: {kind: blocks}, which is wide there alone,"
    return (
        "Declare what switches in plant.effects too, if the model lacks it; or take the jump into the bound:"
        f"{table} {local}gap.lipschitz.rough_limit: {limit:.2g}; or use {_finer(where, found)}."
    )


def _finer(where: SampleGrid, found: GridLipschitz) -> str:
    """Advice for a finer grid: along which states, and how many cells there are now."""
    coarse = [(s, n) for s, n, r in zip(where.states, where.grid.cells, found.ratio, strict=True) if r > GATE]
    along = ", ".join(f"{name} (now {count})" for name, count in coarse)
    return (
        f"more cells along {along}: a smaller grid.eps or half-width (`simgap refine` says where)"
        if along
        else "a smaller grid.eps"
    )
