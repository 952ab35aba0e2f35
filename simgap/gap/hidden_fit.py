"""The bound over hidden states: one dimension after the other, and the gap seen from the robot made of all.

With a value for each input as basis the scenario program solves itself: its solution is the hull over the roll-outs
after a grid of previous inputs. In place of slopes stand two measurements: how fast the influence of older inputs
fades, and by how much equal histories differ between headings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.gap.function import GapDomain
from simgap.gap.hidden_state import TOP, check_fading, extrapolated_maximum, hull
from simgap.gap.symmetry import BodyFrameGap, HeadingDeviation
from simgap.gap.tiers import Tier
from simgap.geometry import Floats
from simgap.simulators.body_samples import BodySamples


@dataclass(frozen=True, eq=False)
class Widened:
    """Hull of one quantity for each input, and by how much random sequences exceed it.

    Attributes:
        lower, upper: (M,) over the grid of previous inputs. excess: largest excess of a random sequence; margin: the
            same, extrapolated.
    """

    lower: Floats
    upper: Floats
    excess: float
    margin: float

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        own = {"lower": self.lower.tolist(), "upper": self.upper.tolist()}
        return own | {"excess": self.excess, "margin": self.margin}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Widened:
        """The inverse of `to_json`."""
        lower, upper = (np.array(data[side], dtype=float) for side in ("lower", "upper"))
        return Widened(lower, upper, float(data["excess"]), float(data["margin"]))


@dataclass(frozen=True, eq=False)
class HullFit:
    """One dimension over hidden states.

    Attributes:
        gap: body-frame gap. swept: extent of the path of one step along this axis; None for the heading.
        grid, sequences: how many roll-outs after previous inputs and steps of random sequences there were.
    """

    gap: Widened
    swept: Widened | None
    grid: int
    sequences: int

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "kind": "hull",
            "program": "solved in closed form: on a value for each input, its least and largest sampled gap",
            "gap": self.gap.to_json(),
            "swept": None if self.swept is None else self.swept.to_json(),
            "grid": self.grid,
            "sequences": self.sequences,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> HullFit:
        """The inverse of `to_json`."""
        swept = None if data["swept"] is None else Widened.from_json(data["swept"])
        return HullFit(Widened.from_json(data["gap"]), swept, int(data["grid"]), int(data["sequences"]))


@dataclass(frozen=True, eq=False)
class HistoryInfluence:
    """What stands in for slopes in one dimension.

    Attributes:
        memory: (L,) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: largest difference between equal histories at different headings; compared: how many there were.
    """

    memory: Floats
    deviation: float
    compared: int

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        own = {"memory": self.memory.tolist(), "deviation": self.deviation, "compared": self.compared}
        return {
            "kind": "histories",
            "lipschitz": "none: the gap is a table over the inputs, not a function of X",
            **own,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> HistoryInfluence:
        """The inverse of `to_json`."""
        return HistoryInfluence(np.array(data["memory"], dtype=float), float(data["deviation"]), int(data["compared"]))


@dataclass(frozen=True, eq=False)
class SweptBoxes:
    """Box in the robot's frame that holds the whole path of one step, the start included: lower, upper (M, 2)."""

    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class HiddenStateFit:
    """The bound with what it rests on.

    Attributes:
        gap, swept: see there; largest: (3,) largest sampled body-frame gap over the grid of previous inputs.
        excess: (3,) largest excess of a random sequence over that hull; margin: (3,) what was added, by extrapolation.
        memory: (L, 3) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: between headings.
    """

    gap: BodyFrameGap
    swept: SweptBoxes
    largest: Floats
    excess: Floats
    margin: Floats
    memory: Floats
    deviation: HeadingDeviation


def fit_hull(
    i: int, motion: Floats, grid: BodySamples, sequences: BodySamples, pose: tuple[int, int, int] = (0, 1, 2)
) -> HullFit:
    """Bound dimension i of the body-frame gap, and the swept extent along it, for every input.

    Args:
        i: which state.
        motion: nominal step seen from the robot, (M, 3).
        grid: roll-outs after the grid of previous inputs, all inputs after each.
        sequences: steps of random sequences.
        pose: which states are x, y and heading.
    """
    count = len(motion)
    lower, upper = hull(grid.m, grid.final[:, [i]] - motion[grid.m][:, [i]], count)
    d = sequences.final[:, [i]] - motion[sequences.m][:, [i]]
    beyond = np.maximum(np.maximum(lower[sequences.m] - d, d - upper[sequences.m]), 0.0)[:, 0]
    gap = Widened(lower[:, 0], upper[:, 0], float(beyond.max()), extrapolated_maximum(beyond))
    swept = _swept(grid, sequences, count, pose[:2].index(i)) if i in pose[:2] else None
    return HullFit(gap, swept, len(grid.m), len(sequences.m))


def _swept(grid: BodySamples, sequences: BodySamples, count: int, axis: int) -> Widened:
    least, most = [2 * axis], [2 * axis + 1]
    lo, _ = hull(grid.m, grid.extent[:, least], count)
    _, hi = hull(grid.m, grid.extent[:, most], count)
    below = np.maximum(lo[sequences.m] - sequences.extent[:, least], 0.0)
    above = np.maximum(sequences.extent[:, most] - hi[sequences.m], 0.0)
    beyond = np.maximum(below, above)[:, 0]
    return Widened(lo[:, 0], hi[:, 0], float(beyond.max()), extrapolated_maximum(beyond))


def assemble_hulls(
    domain: GapDomain, hulls: Sequence[HullFit], influences: Sequence[HistoryInfluence], between_poses: float,
    growth: float, pose: tuple[int, int, int] = (0, 1, 2),
) -> HiddenStateFit:  # fmt: skip
    """The body-frame bound and the swept boxes, widened by what was measured.

    Args:
        domain: X (free along the position) and U.
        hulls, influences: one for each state, in order.
        between_poses: bound of the distance between the path and the line through the recorded poses, m.
        growth: see `check_fading`.
        pose: which states are x, y and heading.

    Raises:
        BrokenPromise: when the bound still grows with the length of the history.
    """
    lower, upper = (np.stack([getattr(h.gap, side) for h in hulls], axis=1) for side in ("lower", "upper"))
    memory = np.stack([influence.memory for influence in influences], axis=1)
    deviation = HeadingDeviation(np.array([own.deviation for own in influences]), influences[0].compared)
    largest = np.maximum(np.abs(lower), np.abs(upper)).max(axis=0)
    check_fading(memory, largest, domain.states, growth)
    excess, margin = (np.array([getattr(h.gap, name) for h in hulls]) for name in ("excess", "margin"))
    raised = margin + deviation.largest
    tiers = _widening_tier(domain.states, hulls[0], memory, excess, margin), deviation.tier(domain.states)
    gap = BodyFrameGap(domain, tiers, lower - raised, upper + raised, pose)
    swept = [own for k in pose[:2] if (own := hulls[k].swept) is not None]
    added = np.array([own.margin for own in swept]) + (float(np.max(deviation.largest[list(pose[:2])])) + between_poses)
    lo, hi = (np.stack([getattr(own, side) for own in swept], axis=1) for side in ("lower", "upper"))
    return HiddenStateFit(gap, SweptBoxes(lo - added, hi + added), largest, excess, margin, memory, deviation)


def _widening_tier(states: Sequence[str], fit: HullFit, memory: Floats, excess: Floats, margin: Floats) -> Tier:
    def named(values: Floats) -> str:
        return ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, values, strict=True))

    return Tier(
        2,
        f"The simulator remembers earlier inputs. The bound of each input is the hull over {fit.grid:,} roll-outs "
        f"after a grid of previous inputs, widened by {named(margin)}: {fit.sequences:,} steps of random input "
        f"sequences exceeded that hull by at most {named(excess)}, extrapolated from their {TOP} largest excesses. "
        f"Inputs more than one sample back move the pose by at most {named(memory[0])}, more than "
        f"{max(len(memory) - 1, 1)} back by {named(memory[max(len(memory) - 2, 0)])}. All of this is an estimate.",
    )
