"""Whether a bound is taken: fresh samples that exceed it, and what measured data leave unexplained."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from simgap.config.gap import GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.tiers import Tier
from simgap.gap.fitting.fresh_check import BorderCheck, FreshCheck


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
    by = ", ".join(f"{value:.3g} for {name}" for name, value in check.worst.items() if value > 0)
    broken = Tier(
        2,
        f"The bound does not hold at every state: {check.violations:,} of {check.samples:,} fresh samples exceed it, "
        f"by up to {by}; the case tolerates that." + (f" {_upper(str(check.outside))}." if check.outside else ""),
    )
    return [broken, *(tier for tier in tiers if tier.level != 1)]


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


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
            words += f" and, as the bound is no table of cells, by {_sizes(box.by)} everywhere"
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
