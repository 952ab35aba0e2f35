"""The gap seen from the robot, put together of all dimensions and widened by what was measured and searched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.function import GapDomain
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.bounds.symmetry import BodyFrameGap
from simgap.gap.bounds.tiers import Tier
from simgap.gap.memory.fit import HistoryInfluence, HullFit
from simgap.gap.memory.headings import HeadingDeviation
from simgap.gap.memory.hidden_state import TOP, check_fading
from simgap.gap.memory.search import BoundTable, Searched

Attack = Callable[[BoundTable], Searched]


@dataclass(frozen=True, eq=False)
class SweptBoxes:
    """Box in the robot's frame that holds the whole path of one step, the start included: lower, upper (C, M, 2)."""

    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class Robot:
    """What the bound is about.

    Attributes:
        domain: X (free along the position) and U. motion: (M, 3) nominal step seen from the robot.
        between_poses: bound of the distance between the path and the line through the recorded poses, m.
        growth: see `check_fading`. classes: of the previous input. pose: which states are x, y and heading.
    """

    domain: GapDomain
    motion: Floats
    between_poses: float
    growth: float
    classes: PreviousClasses
    pose: tuple[int, int, int] = (0, 1, 2)


@dataclass(frozen=True, eq=False)
class HiddenStateFit:
    """The bound with what it rests on.

    Attributes:
        gap, swept: see there; largest: (3,) largest sampled body-frame gap over the grid of previous inputs.
        excess: (3,) largest excess of a random sequence over that hull; margin: (3,) what was added, by extrapolation.
        memory: (L, 3) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: between headings. searched: the directed search on the hull; None without one.
    """

    gap: BodyFrameGap
    swept: SweptBoxes
    largest: Floats
    excess: Floats
    margin: Floats
    memory: Floats
    deviation: HeadingDeviation
    searched: Searched | None = None

    def table(self, motion: Floats) -> BoundTable:
        """The bound as a search attacks it; `motion` (M, 3) is the nominal step."""
        swept = self.swept.lower, self.swept.upper
        return BoundTable(self.gap.classes, motion, self.gap.class_lower, self.gap.class_upper, swept, self.gap.pose)


def assemble_hulls(
    robot: Robot, hulls: Sequence[HullFit], influences: Sequence[HistoryInfluence], attack: Attack | None = None
) -> HiddenStateFit:
    """The body-frame bound and the swept boxes, widened by what was measured and by what `attack` finds beyond them.

    Args:
        robot: see there.
        hulls, influences: one for each state, in order.
        attack: a directed search on the hulls.

    Raises:
        BrokenPromise: when the influence of older inputs does not fall with their age.
    """
    pose, states = robot.pose, robot.domain.states
    lower, upper = (np.stack([getattr(h.gap, side) for h in hulls], axis=-1) for side in ("lower", "upper"))
    memory = np.stack([influence.memory for influence in influences], axis=1)
    deviation = HeadingDeviation(np.array([own.deviation for own in influences]), influences[0].compared)
    largest = np.maximum(np.abs(lower), np.abs(upper)).max(axis=(0, 1))
    check_fading(memory, largest, states, robot.growth, deviation.largest)
    swept = [own for k in pose[:2] if (own := hulls[k].swept) is not None]
    lo, hi = (np.stack([getattr(own, side) for own in swept], axis=-1) for side in ("lower", "upper"))
    excess, margin = (np.array([getattr(h.gap, name) for h in hulls]) for name in ("excess", "margin"))
    path_margin = np.array([own.margin for own in swept])
    searched = attack(BoundTable(robot.classes, robot.motion, lower, upper, (lo, hi), pose)) if attack else None
    if searched is not None:
        excess = np.maximum(excess, searched.excess[:3])
        margin, path_margin = np.maximum(margin, searched.margin[:3]), np.maximum(path_margin, searched.margin[3:])
    raised = margin + deviation.largest
    tiers = _widening_tier(states, hulls[0], memory, excess, margin, searched), deviation.tier(states)
    gap = BodyFrameGap.of_classes(robot.domain, tiers, lower - raised, upper + raised, robot.classes, pose)
    added = path_margin + (float(np.max(deviation.largest[list(pose[:2])])) + robot.between_poses)
    boxes = SweptBoxes(lo - added, hi + added)
    return HiddenStateFit(gap, boxes, largest, excess, margin, memory, deviation, searched)


def _widening_tier(
    states: Sequence[str], fit: HullFit, memory: Floats, excess: Floats, margin: Floats, searched: Searched | None
) -> Tier:
    def named(values: Floats) -> str:
        return ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, values, strict=True))

    classes = len(fit.gap.lower)
    of_class = f" of each of {classes} classes" if classes > 1 else ""
    also = f" and {searched.evaluations:,} steps of a directed search over histories and headings" if searched else ""
    return Tier(
        2,
        f"The simulator remembers earlier inputs. The bound of each input is the hull over {fit.grid:,} roll-outs "
        f"after a grid of previous inputs{of_class}, widened by {named(margin)}: {fit.sequences:,} steps of random "
        f"input sequences{also} exceeded that hull by at most {named(excess)}, extrapolated from their {TOP} largest "
        f"excesses. Inputs more than one sample back move the pose by at most {named(memory[0])}, more than "
        f"{max(len(memory) - 1, 1)} back by {named(memory[max(len(memory) - 2, 0)])}. All of this is an estimate.",
    )
