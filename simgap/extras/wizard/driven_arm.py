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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.extras.wizard.posture import NOTHING, REACH, Posture, beyond_rest, check_room, check_strength
from simgap.geometry import Box
from simgap.model.compile import cached_kernel
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel
from simgap.specifications.reaching import ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.intersample import Flow, flow_of, stray
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.synthesise import SynthesisProblem

TURN, LONGEST = 0.7, 0.1
"""Sampling time: of 1 / the fastest rate of the linear model, and s at most. Judgement."""
CELLS_A_STEP, GAIN, VALUES = 3.1, 0.65, 7
"""A step at full speed crosses so many cells of a position; the inputs change a speed by so much of its half-width, in
so many values. Set on two masses that are pushed, on 16 cells an axis and with the gap of GUESS: .82 of X is won, .73
with PULL; with 5 values, or 5 cells a step, .07 at most; with a gain of .55 .81 and .66."""
PULL = 0.5
"""Of what the inputs do in a step, what gravity and springs may do at the edge of X. Judgement."""
GUESS = 0.04
"""Of what the largest inputs do in a step: the gap that is played against. On that arm .08 leaves .05 of 28 cells."""
TRIED, MORE = (16, 20, 24), 1.3
"""Cells along each axis in the search, more where fewer do not win; as many times more in the case, for a gap that is
larger."""
FARTHEST, STRAYS, TIMES, WEAKER = 1.2, 0.3, 10, 1.5
"""Half-width of X for a position, rad or m, at most; of X what a path may stray between samples; how often torques
are tried, each time by how much weaker. Judgement."""
ENOUGH = 0.15
"""Share of X that ends the search: a smaller X wins more of itself and is of less use. Judgement."""
TARGET, SLOW = 0.3, 0.4
"""Half-widths of the target, of those of X: positions and speeds. Judgement."""


@dataclass(frozen=True)
class Proposal:
    """Numbers for a case.

    Attributes:
        tau: s. X: for each state its ends. U: for each input its least and largest value and their distance.
        cells: along each axis. wins: share of them that the nominal model alone wins.
        free: states on which the motion does not depend.
        part: of the X that is sought (`REACH`), the share along each axis that stops and the largest inputs leave.
        target: the box to reach, by state, where each joint has a motor. None for an X to stay in.
        against: the gap that was played against, as a share of what the largest inputs do in a step; 0 for none.
        rubs: whether what the joints' dry friction leaves as a gap was played against as well.
        narrowed: what left X narrower than sought, each as a noun phrase.
    """

    tau: float
    X: Mapping[str, tuple[float, float]]
    U: Mapping[str, tuple[float, float, float]]
    cells: tuple[int, ...]
    wins: float
    free: tuple[str, ...]
    part: float
    target: Mapping[str, tuple[float, float]] | None = None
    against: float = 0.0
    rubs: bool = False
    narrowed: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, model: SymbolicModel, posture: Posture, tau: float, cells: tuple[int, ...], inputs: Sequence[float],
        steps: Sequence[float], half: Sequence[float], wins: float, part: float, **more: Any,
    ) -> Proposal:  # fmt: skip
        """The case in which a game is played, by the largest inputs beyond those at rest and half of X."""
        U = {}
        for n, rest, most, step in zip(model.input_names, posture.u, inputs, steps, strict=True):
            at = beside(rest, step)
            U[n] = (round(at - most, 12), round(at + most, 12), round(step, 12))
        X = {n: (float(x) - own, float(x) + own) for n, x, own in zip(model.state_names, posture.x, half, strict=True)}
        return cls(tau, X, U, cells, wins, posture.free, part, **more)


def beside(rest: float, step: float) -> float:
    """An input at rest, with two digits more than the distance of its neighbours."""
    return 0.0 if rest == 0.0 else round(float(rest), max(0, 3 - math.floor(math.log10(step))))


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
) -> Iterator[Proposal | UserError]:
    """Numbers for the plant, better and better ones, or why there are none yet; the arguments are those of `propose`.

    Raises:
        UserError: nothing can be won, with what stands in the way.
    """
    taus = {
        "": LONGEST,
        f"a fastest motion of {posture.rate:.3g} 1/s (damping, gravity or springs against the inertia)": TURN
        / posture.rate,
        "the pull of gravity or springs at its edge": _longest_against_pull(model, posture),
    }
    shortest = min(taus, key=taus.__getitem__)
    tau, best = rounded(taus[shortest]), 0.0
    at = dict(zip(model.state_names, posture.x, strict=True))
    check_room({c.position: at[c.position] for c in model.coordinates}, np.full(2, FARTHEST), room)
    most = beyond_rest(model, posture, limits)
    slow = f"{shortest}, which asks for a tau of {tau:g} s" if shortest else ""
    arm = Arm(model, sampled(tau), flow_of(model), posture, most, room, tau, slow)

    def with_the_best(words: str) -> None:
        tell(words + (f"; best so far {best:.2g}" if best else ""))

    for cells in TRIED:
        for found, why in arm.tries(cells, with_the_best):
            if found is not None and found.wins > best:
                best = found.wins
                yield found
                if best >= ENOUGH:
                    return
            elif not best:
                yield UserError(
                    f"no torques win at tau = {tau:g} s: {why}", key="domain",
                    remedy="A longer search (--seconds), another posture (--at), or a shorter tau, a smaller X or "
                    "stronger drives by hand (docs/evidence/two_link.md).",
                )  # fmt: skip


def _longest_against_pull(model: SymbolicModel, posture: Posture) -> float:
    """The sampling time, s, in which gravity and springs at the edge of X change speeds by PULL of what inputs do.

    By the linear model: the edge is cells / (2 CELLS_A_STEP) steps at full speed away, and grows with tau itself.
    """
    names = model.state_names
    rows, columns = ([names.index(getattr(c, kind)) for c in model.coordinates] for kind in ("velocity", "position"))
    pull = float(np.abs(np.linalg.eigvals(np.abs(posture.a[np.ix_(rows, columns)]))).max())
    return math.sqrt(PULL * GAIN * 2 * CELLS_A_STEP / (TRIED[-1] * pull)) if pull else math.inf


def changed(own: NominalModel, posture: Posture, inputs: Floats) -> Floats:
    """How far the largest inputs, together, move each state in a step from rest, (nx,)."""
    corners = posture.u + np.array(list(itertools.product(*((-v, v) for v in inputs))))
    there = own.step(np.tile(posture.x, (len(corners), 1)), corners)
    return np.asarray(np.abs(there - posture.x).max(axis=0))


@dataclass(frozen=True, eq=False)
class Arm:
    """The games of a plant at one posture and sampling time.

    Attributes:
        own, flow: the model over `tau`, s, and along it. most: inputs beyond those at rest, (m,).
        room: for states that have one the interval to stay within. slow: why tau is short, if it is.
    """

    model: SymbolicModel
    own: NominalModel
    flow: Flow
    posture: Posture
    most: Floats
    room: Mapping[str, tuple[float, float]]
    tau: float
    slow: str

    @property
    def axes(self) -> list[tuple[int, int]]:
        """Places of position and speed of each coordinate among the states."""
        names = self.model.state_names
        return [(names.index(c.position), names.index(c.velocity)) for c in self.model.coordinates]

    def tries(self, cells: int, tell: Callable[[str], None]) -> Iterator[tuple[Proposal | None, str]]:
        """A game after the other, with weaker torques while these win more; and what is in the way of one.

        Raises:
            UserError: inputs that move too little.
        """
        gains = np.abs(self.posture.b[[v for _, v in self.axes]]).max(axis=0)
        size, last, names = self._size(gains, cells), -1.0, self.model.state_names
        self._check_strength(size / np.sqrt(gains))
        scale = min(size, float((self.most * np.sqrt(gains)).min()))
        for k in range(TIMES):
            steps = np.array([step_of(scale / WEAKER**k / math.sqrt(g), VALUES, way=math.floor) for g in gains])
            inputs = VALUES // 2 * steps
            half, stopped = self._half(inputs, cells, self.room)
            half = np.array([rounded(v, math.floor) for v in half])
            told = ", ".join(f"{n} +-{v:g}" for n, v in zip(names, half, strict=True))
            tell(f"trying {cells} cells along each axis: {told}")
            wins, why = self.play(half, inputs, cells)
            causes = {
                self.slow: bool(self.slow),
                "the inputs' limits": scale < size,
                "the joints' limits": stopped,
                "one joint's pull on the other": k > 0,
            }
            narrowed = tuple(words for words, holds in causes.items() if holds)
            narrowed = narrowed or ("how differently the inputs move the joints",)
            found = None
            if wins:
                part = min(1.0, *(half[q] / REACH for q, _ in self.axes))
                found = Proposal.of(
                    self.model, self.posture, self.tau, (math.ceil(MORE * cells),) * len(names), tuple(inputs),
                    tuple(steps), tuple(half), wins, part, target=self._target(half), against=GUESS, narrowed=narrowed,
                )  # fmt: skip
            yield found, why
            if wins is not None:
                if wins <= last:  # weaker ones do not help any more: what is left of the plant is linear
                    return
                last = wins

    def _check_strength(self, wanted: Floats) -> None:
        """Refuse inputs that are next to nothing of what X would take, (m,), or that do next to nothing in a step.

        Raises:
            UserError: with the inputs or, where they would be enough for the longest step, the plant's rate.
        """
        check_strength(self.model.input_names, self.most, wanted * (self.tau / LONGEST) ** 2)
        if (self.most < NOTHING * wanted).all():
            raise UserError(
                f"its fastest motion has a rate of {self.posture.rate:.3g} 1/s, and in the tau of {self.tau:g} s that "
                "this asks for the inputs hardly move anything", key="domain.tau",
                remedy="Look at the joints' damping and the links' inertias, or take other joints (--joints).",
            )  # fmt: skip

    def _size(self, gains: Floats, cells: int) -> float:
        """Of the inputs, times the root of their gain, with which X is as wide as it may be."""
        one, _ = self._half(1e-3 / np.sqrt(gains), cells, {})
        return 1e-3 * FARTHEST / max(one[q] for q, _ in self.axes)

    def _half(self, inputs: Floats, cells: int, room: Mapping[str, tuple[float, float]]) -> tuple[Floats, bool]:
        """Half-widths of X for these inputs, (nx,), and whether the room of a state makes them less."""
        names, x, free_ends = self.model.state_names, self.posture.x, (-math.inf, math.inf)
        moved, half, stopped = changed(self.own, self.posture, inputs), np.zeros(len(names)), False
        for q, v in self.axes:
            speed = moved[v] / GAIN
            lo, hi = room.get(names[v], free_ends)
            half[v] = min(speed, 0.9 * hi, -0.9 * lo)
            lo, hi = room.get(names[q], free_ends)
            free = min(hi - x[q], x[q] - lo) - 1.5 * self.tau * half[v]
            wide = min(half[v] * self.tau * cells / (2 * CELLS_A_STEP), FARTHEST)
            half[q] = min(wide, free)
            stopped |= bool(half[v] < speed or half[q] < wide)
        return half, stopped

    def play(self, half: Floats, inputs: Floats, cells: int) -> tuple[float | None, str]:
        """The share of X that wins against a small gap, None if a path leaves its room; what is in the way."""
        names, x = self.model.state_names, self.posture.x
        if (half <= 0).any():
            return None, "the posture leaves the joints no room for a step before their stops"
        space = Space(names, Box(x - half, x + half))
        every = self.posture.u + np.array(list(itertools.product(*(np.linspace(-v, v, VALUES) for v in inputs))))
        spread = GUESS * changed(self.own, self.posture, inputs)
        bound = stray(self.flow, space.box, every, self.tau, spread / self.tau)
        if bound is None:
            return None, "at speeds that give the cells a chance one joint throws the other out of X between samples"
        paths = bound[0]
        if (paths[1] > STRAYS * half).any():
            worst = names[int((paths[1] / half).argmax())]
            return None, f"between samples {worst} strays by more than {STRAYS:g} of X"
        specification = ReachAvoid(kind="reach_avoid", target=self._target(half))
        problem = SynthesisProblem(
            self.own, specification, space, (cells,) * len(names), beside_inputs(every, spread), gap_beside_inputs(),
            [], stray=paths,
        )  # fmt: skip
        solution = specification.solve(problem.game())
        wins = float(solution.winning.mean()) if solution.useful else 0.0
        return wins, "" if wins else "the inputs do not bring the plant to the target on these cells"

    def _target(self, half: Floats) -> dict[str, tuple[float, float]]:
        """The box to reach, around the posture."""
        speeds = {v for _, v in self.axes}
        shares = [SLOW if j in speeds else TARGET for j in range(len(half))]
        ends = zip(self.model.state_names, self.posture.x, shares * half, strict=True)
        return {n: (float(at - own), float(at + own)) for n, at, own in ends}


def beside_inputs(inputs: Floats, spread: Floats) -> Floats:
    """Inputs (M, nu) with a gap of +-spread (nx,) behind each, which `gap_beside_inputs` reads: (M, nu + nx)."""
    return np.hstack([inputs, np.tile(spread, (len(inputs), 1))])


@cache
def gap_beside_inputs() -> Kernel:
    """The gap that stands behind an input. It is compiled once, whatever gaps are tried."""

    @cached_kernel
    def gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        first = len(u) - len(lo)
        for i in range(len(lo)):
            lo[i], hi[i] = -u[first + i], u[first + i]

    return gap


Rounding = Callable[[float], int]


def step_of(half: float, count: int, most: float = math.inf, way: Rounding = round) -> float:
    """Between so many values of an input from -half to half; less where what is rounded would pass `most`."""
    step = rounded(2 * half / (count - 1), way)
    return step if step * (count // 2) <= most else rounded(2 * min(half, most) / (count - 1), math.floor)


def rounded(value: float, way: Rounding = round) -> float:
    """Two significant digits, as a person would write them; a size that is to be no larger by `math.floor`."""
    if value == 0.0:
        return 0.0
    digits = 1 - math.floor(math.log10(abs(value)))
    whole = way(round(abs(value) * 10.0**digits, 9))
    return math.copysign(round(whole / 10.0**digits, max(digits, 0)), value)
