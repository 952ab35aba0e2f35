"""Covering what earlier inputs leave behind in a simulator whose state is larger than x.

A roll-out from rest is not the map that a controller meets: wheels and body still move as the previous input told them.
The bound for an input is therefore the hull over previous inputs (a grid of them, extremes included), widened by what
random input sequences of any length, at any heading, show beyond that hull. That it is wide enough is an estimate; how
fast the influence of older inputs fades is measured and must be small before the bound is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.errors import BrokenPromise, UserError
from simgap.gap.function import GapDomain
from simgap.gap.symmetry import BodyFrameGap, HeadingDeviation
from simgap.gap.thresholds import BEYOND_CONFIDENCE
from simgap.gap.tiers import Tier
from simgap.geometry import Floats
from simgap.simulators.body_samples import BodySamples, Ints

TOP = 20


@dataclass(frozen=True, eq=False)
class BodySweep:
    """Box in the robot's frame that holds the whole way of one step, the start included: lower, upper (M, 2)."""

    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class HiddenStateFit:
    """The bound with what it rests on.

    Attributes:
        gap, sweep: see there; d: (P, M, 3) body-frame gap over the grid of previous inputs.
        excess: (3,) largest excess of a random sequence over that hull; margin: (3,) what was added, by extrapolation.
        memory: (L, 3) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
    """

    gap: BodyFrameGap
    sweep: BodySweep
    d: Floats
    excess: Floats
    margin: Floats
    memory: Floats


def previous_inputs(values: Sequence[Floats], counts: Sequence[int]) -> Floats:
    """A grid of previous inputs: of each input's values the extremes and evenly spaced ones between, (P, nu).

    Raises:
        UserError: more asked for than there are, or fewer than both extremes.
    """
    picked = []
    for own, count in zip(values, counts, strict=True):
        if not min(2, len(own)) <= count <= len(own):
            raise UserError(
                f"{count} previous values of an input that has {len(own)}", key="hidden_state.previous",
                remedy=f"Take between 2 and {len(own)}.",
            )  # fmt: skip
        picked.append(own[np.round(np.linspace(0, len(own) - 1, count)).astype(int)])
    return np.array(list(itertools.product(*picked)), dtype=np.float64)


def random_sequences(inputs: Floats, n: int, length: int, rng: np.random.Generator) -> Ints:
    """Input numbers (n, length): half of the coordinates at an extreme of U, where histories matter most."""
    values = [np.unique(inputs[:, j]) for j in range(inputs.shape[1])]
    drawn = np.empty((n * length, inputs.shape[1]))
    for j, own in enumerate(values):
        extreme = rng.random(n * length) < 0.5
        drawn[:, j] = np.where(extreme, own[[0, -1]][rng.integers(2, size=n * length)], rng.choice(own, n * length))
    position = {tuple(u): m for m, u in enumerate(inputs.tolist())}
    if len(position) != int(np.prod([len(v) for v in values])):
        raise UserError("hidden states need an input set that is a full grid", key="domain.U")
    return np.array([position[tuple(u)] for u in drawn.tolist()], dtype=np.int64).reshape(n, length)


def fading(responses: Floats) -> Floats:
    """Influence of older inputs: responses (L, n, 3) after the last 1, 2, ..., L inputs of n histories -> (L, 3).

    Row l is the largest difference that the inputs more than l + 1 samples back make, out of L.
    """
    return np.abs(responses - responses[-1]).max(axis=1)


def check_fading(memory: Floats, size: Floats, states: Sequence[str], growth: float) -> None:
    """Older inputs must have lost their influence at the longest history but one.

    Raises:
        BrokenPromise: naming the state and both numbers.
    """
    if len(memory) < 2:
        return
    for name, left, own in zip(states, memory[-2], size, strict=True):
        if left > growth * own:
            raise BrokenPromise(
                f"the gap in {name} still grows with the length of the history: inputs more than {len(memory) - 1} "
                f"samples back move it by {left:.3g}, allowed is {growth:g} of its sup, {growth * own:.3g}",
                "Raise hidden_state.length, lengthen tau, or stiffen the motors",
            )


def extrapolated_maximum(excess: Floats, top: int = TOP, confidence: float = BEYOND_CONFIDENCE) -> float:
    """Upper estimate of the supremum behind a sample of excesses, >= its maximum (0 when nothing exceeds).

    `M1 + (M1 - Mk) r / (1 - r)`, `r = 1 - (1 - confidence)^(1/(k - 1))`, from the k largest (de Haan 1981).
    """
    k = min(top, len(excess))
    largest = np.sort(excess)[-k:]
    if k < 2 or largest[-1] <= 0:
        return max(float(largest[-1]), 0.0)
    r = 1.0 - (1.0 - confidence) ** (1.0 / (k - 1))
    return float(largest[-1] + (largest[-1] - max(largest[0], 0.0)) * r / (1.0 - r))


def hull(m: Ints, values: Floats, inputs: int) -> tuple[Floats, Floats]:
    """Least and largest of values (n, k) per input number: -> (inputs, k) twice; (inf, -inf) without samples."""
    lo, hi = np.full((inputs, values.shape[1]), np.inf), np.full((inputs, values.shape[1]), -np.inf)
    np.minimum.at(lo, m, values)
    np.maximum.at(hi, m, values)
    return lo, hi


def fit_hidden_state(
    domain: GapDomain,
    motion: Floats,
    grid: BodySamples,
    chains: BodySamples,
    memory: Floats,
    deviation: HeadingDeviation,
    between_poses: float,
    growth: float,
    pose: tuple[int, int, int] = (0, 1, 2),
) -> HiddenStateFit:
    """Bound the body-frame gap and the swept box of every input.

    Args:
        domain: X (free along the position) and U.
        motion: nominal step seen from the robot, (M, 3).
        grid: roll-outs after the grid of previous inputs, all inputs after each, (P M) rows in that order.
        chains: steps of random sequences.
        memory: what `fading` gave; growth: see `check_fading`.
        deviation: between headings.
        between_poses: bound of the distance between the way and the line through the recorded poses, m.

    Raises:
        BrokenPromise: when the bound still grows with the length of the history.
    """
    count = len(motion)
    lower, upper = hull(grid.m, grid.final - motion[grid.m], count)
    check_fading(memory, np.maximum(np.abs(lower), np.abs(upper)).max(axis=0), domain.states, growth)
    d = chains.final - motion[chains.m]
    beyond = np.maximum(np.maximum(lower[chains.m] - d, d - upper[chains.m]), 0.0)
    margin = np.array([extrapolated_maximum(e) for e in beyond.T])
    raised = margin + deviation.largest
    tiers = _tiers(domain.states, grid, chains, memory, beyond.max(axis=0), margin, deviation)
    gap = BodyFrameGap(domain, tiers, lower - raised, upper + raised, pose)
    sweep = _swept(grid, chains, count, float(np.max(deviation.largest[list(pose[:2])])) + between_poses)
    shape = (len(grid.m) // count, count, 3)
    return HiddenStateFit(gap, sweep, (grid.final - motion[grid.m]).reshape(shape), beyond.max(axis=0), margin, memory)


def _swept(grid: BodySamples, chains: BodySamples, count: int, added: float) -> BodySweep:
    lo, _ = hull(grid.m, grid.extent[:, [0, 2]], count)
    _, hi = hull(grid.m, grid.extent[:, [1, 3]], count)
    below = np.maximum(lo[chains.m] - chains.extent[:, [0, 2]], 0.0)
    above = np.maximum(chains.extent[:, [1, 3]] - hi[chains.m], 0.0)
    margin = np.array([extrapolated_maximum(e) for e in np.maximum(below, above).T]) + added
    return BodySweep(lo - margin, hi + margin)


def _tiers(
    states: Sequence[str],
    grid: BodySamples,
    chains: BodySamples,
    memory: Floats,
    excess: Floats,
    margin: Floats,
    deviation: HeadingDeviation,
) -> tuple[Tier, ...]:
    def named(values: Floats) -> str:
        return ", ".join(f"{v:.2g} for {s}" for s, v in zip(states, values, strict=True))

    hidden = Tier(
        2,
        f"The simulator remembers earlier inputs. The bound of each input is the hull over {len(grid.m):,} roll-outs "
        f"after a grid of previous inputs, widened by {named(margin)}: {len(chains.m):,} steps of random input "
        f"sequences exceeded that hull by at most {named(excess)}, extrapolated from their {TOP} largest excesses. "
        f"Inputs more than one sample back move the pose by at most {named(memory[0])}, more than "
        f"{max(len(memory) - 1, 1)} back by {named(memory[max(len(memory) - 2, 0)])}. All of this is an estimate.",
    )
    return hidden, deviation.tier(states)


def tolerance_of(states: Sequence[str], given: Mapping[str, float]) -> dict[str, float]:
    """The tolerance for every state.

    Raises:
        UserError: a state without one, or an unknown name.
    """
    missing, unknown = [s for s in states if s not in given], [s for s in given if s not in states]
    if missing or unknown:
        raise UserError(
            f"no tolerance for {missing}" if missing else f"no state called {unknown}", key="symmetry.tolerance",
            remedy=f"Give one number for each of {', '.join(states)}.",
        )  # fmt: skip
    return {s: float(given[s]) for s in states}
