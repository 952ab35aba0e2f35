"""Numbers for an arm each of whose joints has a motor: a box of postures to reach from all around it.

Such a plant needs no regulator that holds it, and the linear model says nothing of how far it may be moved. What does
is how its motion divides into cells: a step at full speed crosses `CELLS_A_STEP` cells of a position, and the inputs
change a speed by `GAIN` of its half-width within a step. With sampling time and torques given, both give X. What grows
with the torques, as the square of the speeds, is the pull of one joint on the other: torques begin at what drives and
stops allow, and are made weaker until the path between samples is bounded and the game is won with a gap of `GUESS` of
what the inputs do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from simgap.arrays import Floats
from simgap.errors import BrokenPromise, UserError
from simgap.extras.wizard.budget import Budget
from simgap.extras.wizard.posture import Posture, check_room, check_strength
from simgap.geometry import Box
from simgap.late import numba
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel
from simgap.specifications.reach_avoid import ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.intersample import Flow, excursion, flow_of
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.synthesise import SynthesisProblem

TURN, LONGEST = 0.7, 0.1
"""Sampling time: of 1 / the fastest rate of the linear model, and s at most. Judgement."""
CELLS_A_STEP, GAIN = 3.1, 0.45
"""Of a light and damped arm of .35 m and .26 m, .36 of X is won with a gap on 28 cells an axis where a step at full
speed crosses 3.1 cells, and .03 where it crosses 1.6; the inputs change a speed by .45 of its half-width."""
GUESS = 0.04
"""Of what the largest inputs do in a step: the gap that is played against. On that arm .08 leaves .05 of 28 cells."""
FEW, TRIED, MORE, VALUES = 10, 28, 1.3, 5
"""Cells along each axis where a game is timed, and in the search; as many times more in the case, for a gap that is
larger; values of an input."""
FARTHEST, STRAYS, TIMES, WEAKER = 1.2, 0.3, 10, 1.5
"""Half-width of X for a position, rad or m, at most; of X what a path may stray between samples; how often torques
are tried, each time by how much weaker. Judgement."""
ENOUGH = 0.15
"""Share of X that ends the search: a smaller X wins more of itself and is of less use. Judgement."""
TARGET, SLOW = 0.3, 0.4
"""Half-widths of the target, of those of X: positions and speeds. Judgement."""


@dataclass(frozen=True)
class Driven:
    """What was found: as `proposal.Proposal`, with the box to reach by state."""

    tau: float
    half: tuple[float, ...]
    inputs: tuple[float, ...]
    cells: tuple[int, ...]
    wins: float
    target: Mapping[str, tuple[float, float]]


def is_driven(model: SymbolicModel) -> bool:
    """True if there is an input for each of two coordinates, and no other state."""
    return len(model.coordinates) == len(model.inputs) == 2 and len(model.states) == 4


def driven(
    model: SymbolicModel,
    sampled: Callable[[float], NominalModel],
    posture: Posture,
    limits: Mapping[str, float],
    room: Mapping[str, tuple[float, float]],
    tell: Callable[[str], None],
    budget: Budget,
) -> Driven:
    """Numbers for the plant; the arguments are those of `propose`, and `budget` has its time.

    Raises:
        UserError: nothing is won, with what stands in the way.
    """
    tau = rounded(min(LONGEST, TURN / posture.rate))
    check_room([c.position for c in model.coordinates], np.full(2, FARTHEST), room)
    own, flow, reason = sampled(tau), flow_of(model), "no torques were tried within the time"
    names, axes = model.state_names, [(c.position, c.velocity) for c in model.coordinates]
    gains = np.abs(posture.b[[names.index(v) for _, v in axes]]).max(axis=0)
    if (gains <= 0.0).any():
        raise UserError(
            "an input does not move the plant at this posture", key="--at",
            remedy="Name another one, or choose tau, X and U by hand.",
        )  # fmt: skip
    most = np.array([limits.get(n, math.inf) - abs(u) for n, u in zip(model.input_names, posture.u, strict=True)])
    size = _size(own, posture, gains, axes, names, tau)
    check_strength(model.input_names, most, size / np.sqrt(gains))
    scale = min(size, float((most * np.sqrt(gains)).min()))
    best: Driven | None = None
    for _ in range(TIMES):
        inputs = np.array([rounded(scale / math.sqrt(g), down=True) for g in gains])
        half = _half(own, posture, inputs, axes, names, room, tau)
        if (half <= 0).any():
            raise UserError(
                "the posture leaves the joints no room before their stops", key="--at", remedy="Name another one."
            )
        half = np.array([rounded(v, down=True) for v in half])
        game = partial(_play, model, own, flow, posture, half, inputs, tau, reason)
        budget.gauge(FEW ** len(names) * VALUES**2, partial(game, FEW))
        if not budget.allows(TRIED ** len(names) * VALUES**2):
            break
        told = ", ".join(f"{n} +-{v:g}" for n, v in zip(names, half, strict=True))
        tell(f"trying {TRIED} cells along each axis: {told}" + (f"; best so far {best.wins:.2g}" if best else ""))
        wins, reason = budget.spent(TRIED ** len(names) * VALUES**2, game)
        if best is None or wins > best.wins:
            cells = (math.ceil(MORE * TRIED),) * len(names)
            best = Driven(tau, tuple(half), tuple(inputs), cells, wins, _target(model, posture, half))
        if best.wins >= ENOUGH:
            break
        scale /= WEAKER
    if best is None or best.wins == 0.0:
        raise UserError(
            f"no torques win at tau = {tau:g} s: {reason}", key="domain",
            remedy="A longer search (--seconds), or a shorter tau, a smaller X or stronger drives by hand "
            "(docs/evidence/two_link.md).",
        )  # fmt: skip
    return best


def changed(own: NominalModel, posture: Posture, inputs: Floats) -> Floats:
    """How far the largest inputs, together, move each state in a step from rest, (nx,)."""
    corners = posture.u + np.array(list(itertools.product(*((-v, v) for v in inputs))))
    there = own.step(np.tile(posture.x, (len(corners), 1)), corners)
    return np.asarray(np.abs(there - posture.x).max(axis=0))


def _half(
    own: NominalModel, posture: Posture, inputs: Floats, axes: list[tuple[str, str]], names: tuple[str, ...],
    room: Mapping[str, tuple[float, float]], tau: float,
) -> Floats:  # fmt: skip
    """Half-widths of X for these inputs, (nx,)."""
    moved, half = changed(own, posture, inputs), np.zeros(len(names))
    for q, v in axes:
        j, k = names.index(q), names.index(v)
        speed = moved[k] / GAIN
        lo, hi = room.get(v, (-math.inf, math.inf))
        half[k] = min(speed, 0.9 * hi, -0.9 * lo)
        stops = room.get(q, (-math.inf, math.inf))
        free = min(stops[1] - posture.x[j], posture.x[j] - stops[0]) - 1.5 * tau * half[k]
        half[j] = min(half[k] * tau * TRIED / (2 * CELLS_A_STEP), free, FARTHEST)
    return half


def _size(
    own: NominalModel, posture: Posture, gains: Floats, axes: list[tuple[str, str]], names: tuple[str, ...], tau: float
) -> float:
    """Of the inputs, times the root of their gain, with which X is as wide as it may be."""
    one = _half(own, posture, 1e-3 / np.sqrt(gains), axes, names, {}, tau)
    widest = max(one[names.index(q)] for q, _ in axes)
    return 1e-3 * FARTHEST / widest


def _play(
    model: SymbolicModel, own: NominalModel, flow: Flow, posture: Posture, half: Floats, inputs: Floats,
    tau: float, reason: str, cells: int = TRIED,
) -> tuple[float, str]:  # fmt: skip
    """The share of X that wins against the path between samples and a small gap, and what was in the way."""
    names, x = model.state_names, posture.x
    space = Space(names, Box(x - half, x + half))
    every = posture.u + np.array(list(itertools.product(*(np.linspace(-v, v, VALUES) for v in inputs))))
    spread = GUESS * changed(own, posture, inputs)
    try:
        stray, _ = excursion(flow, space.box, every, tau, spread / tau, names)
    except BrokenPromise:
        return 0.0, "at speeds that give the cells a chance one joint throws the other out of X between two samples"
    if (stray[1] > STRAYS * half).any():
        worst = names[int((stray[1] / half).argmax())]
        return 0.0, f"between samples {worst} strays by more than {STRAYS:g} of X"
    specification = ReachAvoid(kind="reach_avoid", target=_target(model, posture, half))
    problem = SynthesisProblem(
        own, specification, space, (cells,) * len(names), every, gap=constant(spread), gap_axes=[], stray=stray
    )
    solution = specification.solve(problem.game())
    wins = float(solution.winning.mean()) if solution.useful else 0.0
    return wins, reason if wins else "the inputs do not bring the plant to the target on these cells"


def _target(model: SymbolicModel, posture: Posture, half: Floats) -> dict[str, tuple[float, float]]:
    """The box to reach, around the posture."""
    speeds = {c.velocity for c in model.coordinates}
    shares = [SLOW if n in speeds else TARGET for n in model.state_names]
    ends = zip(model.state_names, posture.x, shares * half, strict=True)
    return {n: (float(at - own), float(at + own)) for n, at, own in ends}


def constant(spread: Floats) -> Kernel:
    """A gap of +-spread everywhere."""

    @numba.njit(error_model="numpy")
    def gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        for i in range(len(lo)):
            lo[i], hi[i] = -spread[i], spread[i]

    found: Kernel = gap
    return found


def rounded(value: float, down: bool = False) -> float:
    """Two significant digits, as a person would write them; toward 0 where it is to be no larger."""
    if value == 0.0:
        return 0.0
    digits = 1 - math.floor(math.log10(abs(value)))
    scaled = abs(value) * 10.0**digits
    whole = math.floor(scaled + 1e-9) if down else round(scaled)
    return math.copysign(round(whole / 10.0**digits, max(digits, 0)), value)
