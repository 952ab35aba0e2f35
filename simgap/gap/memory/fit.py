"""The bound over hidden states, one dimension after the other; `hidden_bound` makes the gap seen from the robot of all.

With a value for each input as basis the scenario program solves itself: its solution is the hull over the roll-outs
after a grid of previous inputs. In place of slopes stand two measurements: how fast the influence of older inputs
fades, and by how much equal histories differ between headings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.json_record import JsonRecord
from simgap.gap.memory.hidden_state import COORDINATES, hull
from simgap.simulators.body_samples import BodySamples
from simgap.statistics import extrapolated_maximum


@dataclass(frozen=True, eq=False)
class Widened(JsonRecord):
    """Hull of one quantity for each class of the previous input and each input, and what random sequences exceed it by.

    Attributes:
        lower, upper: (C, M) over the grid of previous inputs. excess: largest excess of a random sequence; margin: the
            same, extrapolated.
    """

    lower: Floats
    upper: Floats
    excess: float
    margin: float


@dataclass(frozen=True, eq=False)
class HullFit(
    JsonRecord,
    kind="hull",
    program="solved in closed form: on a value for each input, its least and largest sampled gap",
):
    """One dimension over hidden states.

    Attributes:
        gap: body-frame gap. swept: extent of the path of one step along this axis; None for the heading.
        grid, sequences: how many roll-outs after previous inputs and steps of random sequences there were.
    """

    gap: Widened
    swept: Widened | None
    grid: int
    sequences: int


@dataclass(frozen=True, eq=False)
class HistoryInfluence(
    JsonRecord, kind="histories", lipschitz="none: the gap is a table over the inputs, not a function of X"
):
    """Influence of earlier inputs and of the heading in one dimension, in place of slopes.

    Attributes:
        memory: (L,) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: largest difference between equal histories at different headings; compared: how many there were.
    """

    memory: Floats
    deviation: float
    compared: int


def fit_hull(
    i: int, motion: Floats, grid: BodySamples, sequences: BodySamples, pose: tuple[int, int, int] = (0, 1, 2),
    classes: PreviousClasses | None = None,
) -> HullFit:  # fmt: skip
    """Bound dimension i of the body-frame gap, and the swept extent along it, for every class and input.

    Args:
        i: which state.
        motion: nominal step seen from the robot, (M, 3).
        grid: roll-outs after the grid of previous inputs, all inputs after each.
        sequences: steps of random sequences.
        pose: which states are x, y and heading.
        classes: of the previous input; one if not given.
    """
    known = classes or PreviousClasses.single(len(motion))
    d = grid.final[:, i] - motion[grid.m, i], sequences.final[:, i] - motion[sequences.m, i]
    gap = _widened(grid, sequences, known, (d[0], d[0]), (d[1], d[1]))
    swept = None
    if i in pose[:2]:
        axis = pose[:2].index(i)
        ends = [(own.extent[:, 2 * axis], own.extent[:, 2 * axis + 1]) for own in (grid, sequences)]
        swept = _widened(grid, sequences, known, *ends)
    return HullFit(gap, swept, len(grid.m), len(sequences.m))


Ends = tuple[Floats, Floats]


def _widened(grid: BodySamples, sequences: BodySamples, classes: PreviousClasses, inner: Ends, outer: Ends) -> Widened:
    """Hull of least and largest values over the grid, `inner`, and what those of the sequences, `outer`, exceed."""
    inputs = len(classes.kind)
    place = classes.after(grid.previous) * inputs + grid.m
    lower = hull(place, inner[0][:, None], classes.count * inputs)[0].reshape(classes.count, inputs)
    upper = hull(place, inner[1][:, None], classes.count * inputs)[1].reshape(classes.count, inputs)
    own = classes.after(sequences.previous), sequences.m
    excess = np.maximum(np.maximum(lower[own] - outer[0], outer[1] - upper[own]), 0.0)
    return Widened(lower, upper, float(excess.max()), extrapolated_maximum(excess, COORDINATES))
