"""Sampling time, X, U and cells with which the nominal model of a plant wins something.

The linear model around a posture says how they have to be to each other (`posture`); how strong the inputs have to be
for a box is found by solving the nominal model's own game on coarse cells, a few seconds each.

Dry friction that the model lacks leaves a gap, which is guessed. A force of constant size against the speed moves the
states by a known amount a step, forwards or backwards: a gap that is shifted and not wide, but where the speed changes
its sign within the step. By the linear model around a posture the speed goes from v to v' = (A x + B u)_j, and the
force points against it for (v + v') / (|v| + |v'|) of the step on balance. A table of blocks bounds that over a block.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from simgap.arrays import Floats
from simgap.deadline import last_within
from simgap.errors import UserError
from simgap.extras.wizard.driven_arm import (
    Proposal,
    beside,
    beside_inputs,
    changed,
    driven,
    gap_beside_inputs,
    is_driven,
    rounded,
    step_of,
)
from simgap.extras.wizard.posture import (
    REACH,
    Posture,
    Proportions,
    beyond_rest,
    check_moved,
    check_room,
    check_strength,
    posture_of,
    proportions,
    unmoved,
)
from simgap.geometry import Box
from simgap.late import numba, scipy
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.synthesise import SynthesisProblem

RUBBING, RESTING = {1: 80, 2: 24}, {2: 25, 3: 10, 4: 8}
"""Cells of the grid, and blocks of the bound, where joints rub: along each speed that friction turns round with, by the
number of such speeds, and along each other axis, by the number of all. On a two-link arm with a tenth of its torques as
dry friction, 10 cells along a speed gave nothing and 24 won .56 of the cells, where the model alone wins .75."""


FINER = 1.6
"""Times as many cells along the speeds at which a dry friction turns round. On a cart with a pole and .07 of its force
as friction, 42 x 32 x 50 x 35 cells won nothing with the gap, 80 along the speed .46, and two thirds more along all
axes .50."""


def blocks_along(kept: Sequence[str], rubbing: Collection[str]) -> dict[str, int]:
    """Cells along each axis on which the gap may depend, where the speeds `rubbing` turn a dry friction round."""
    fine = RUBBING.get(len([n for n in kept if n in rubbing]), 12)
    return {n: fine if n in rubbing else RESTING.get(len(kept), 8) for n in kept}


@dataclass(frozen=True, eq=False)
class Rubbing:
    """Dry friction of k joints over one sampling time, around a posture.

    Attributes:
        names, free: the states, and those on which the motion does not depend.
        speeds: (k,) the state that is the speed of each. pushed: (k, n) what the force adds to the states in a step.
        following: (k, n + m) the speed after a step, by state and input; rest: (k,) its constant.
    """

    names: tuple[str, ...]
    free: tuple[str, ...]
    speeds: tuple[int, ...]
    pushed: Floats
    following: Floats
    rest: Floats

    def finer(self, cells: Sequence[int]) -> tuple[int, ...]:
        """More cells along the speeds."""
        return tuple(math.ceil(FINER * n) if j in self.speeds else n for j, n in enumerate(cells))

    def gap(self, half: Floats, spread: Floats) -> Kernel:
        """The gap as a table of blocks on X of these half-widths would bound it."""
        kept = [n for n in self.names if n not in self.free]
        along = blocks_along(kept, [self.names[j] for j in self.speeds])
        return _kernel(
            np.array(self.speeds), self.pushed, self.following, self.rest,
            np.array([2.0 * half[i] / along[n] if n in along else 0.0 for i, n in enumerate(self.names)]), spread,
        )  # fmt: skip


def rubbing(model: SymbolicModel, posture: Posture, friction: Mapping[str, float] | None, tau: float) -> Rubbing | None:
    """Effect of the dry friction of joints, by name, on the states over tau; None where no joint has any."""
    friction = friction or {}
    rubs = [c for c in model.coordinates if friction.get(c.name, 0.0) > 0.0]
    if not rubs:
        return None
    names = model.state_names
    here = dict(zip([v.symbol for v in model.states], posture.x, strict=True)) | model.values()
    forces = np.array([[float(e.subs(here)) for e in model.force_map[c.name]] for c in rubs]).T
    sizes = np.array([friction[c.name] for c in rubs])
    n, m, k = len(names), posture.b.shape[1], len(rubs)
    whole = np.zeros((n + m + k, n + m + k))
    whole[:n] = np.hstack([posture.a, posture.b, forces * sizes])
    step = scipy.linalg.expm(whole * tau)[:n]
    speeds = tuple(names.index(c.velocity) for c in rubs)
    following = step[list(speeds), : n + m]
    return Rubbing(
        names, posture.free, speeds, step[:, n + m :].T.copy(), following,
        posture.x[list(speeds)] - following @ np.concatenate([posture.x, posture.u]),
    )  # fmt: skip


def _kernel(speeds: Floats, pushed: Floats, following: Floats, rest: Floats, block: Floats, spread: Floats) -> Kernel:
    @numba.njit(error_model="numpy")
    def against(v, then):  # type: ignore[no-untyped-def]
        """Share of a step for which the force points backwards, less that for which it points forwards."""
        both = abs(v) + abs(then)
        return (v + then) / both if both > 0.0 else 0.0

    @numba.njit(error_model="numpy")
    def gap(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        n = len(lo)
        for i in range(n):
            lo[i], hi[i] = -spread[i], spread[i]
        for r in range(len(speeds)):
            j = speeds[r]
            least = most = rest[r]
            for i in range(n):
                a, b = following[r, i] * (xlo[i] - block[i]), following[r, i] * (xhi[i] + block[i])
                least += min(a, b)
                most += max(a, b)
            for i in range(len(u)):
                least += following[r, n + i] * u[i]
                most += following[r, n + i] * u[i]
            fewest = against(xlo[j] - block[j], least)
            largest = against(xhi[j] + block[j], most)
            for i in range(n):
                a, b = -pushed[r, i] * fewest, -pushed[r, i] * largest
                lo[i] += min(a, b)
                hi[i] += max(a, b)

    found: Kernel = gap
    return found


SHARES = (0.1, 0.2, 0.4)
"""Of the input that a linear feedback takes at the worst corner of the box: what is tried, and the first that wins is
taken. A pole on a cart wins .18 of its box with .09 of it. Stronger ones are farther apart, which costs cells."""
TRAVEL = 1.2
"""Times what a step travels by the linear model, kept free before the stops of a joint: an engine brakes a bit before
them, and the model is not linear. Judgement."""
GROWTH = 2.5
"""Times as many cells from one round to the next."""
PAIRS = 60_000_000
"""Most pairs of cell and input of one try: half a minute of CPU; of the coarsest, which the linear model asks for, ten
times as many."""
VALUES = {1: 15, 2: 5}
"""Values of each of one or two inputs at least, and `FEWER` of more; the posture's own is among them."""
FEWER, MOST, FEWEST = 3, 15, 10
"""Values of an input at least, and at most where strong ones have to lie close; cells along an axis at least."""


@dataclass(frozen=True, eq=False)
class Search:
    """The games of a plant at one posture; `limits` and `room` as `propose` has them, `rubs` where joints do."""

    model: SymbolicModel
    sampled: NominalModel
    posture: Posture
    shape: Proportions
    limits: Mapping[str, float]
    room: Mapping[str, tuple[float, float]]
    rubs: Rubbing | None = None

    def check(self) -> None:
        """Refuse what leaves X next to no size.

        Raises:
            UserError: a state without room, or inputs that are far too weak.
        """
        sought = self.sought()
        check_room(dict(zip(self.model.state_names, self.posture.x, strict=True)), sought, self.room)
        most = beyond_rest(self.model, self.posture, self.limits)
        check_strength(self.model.input_names, most, SHARES[0] * np.abs(self.shape.gain) @ sought)

    @property
    def least(self) -> int:
        """Values of each input at least."""
        return VALUES.get(len(self.model.inputs), FEWER)

    def rounds(self) -> Iterator[tuple[int, ...]]:
        """Cells along each axis: as the linear model asks, then more while they are affordable."""
        for k in itertools.count():
            more = GROWTH ** (k / len(self.shape.cells))
            cells = tuple(max(FEWEST, math.ceil(n * more)) for n in self.shape.cells)
            if math.prod(cells) * self.least ** len(self.model.inputs) > (PAIRS if k else 10 * PAIRS):
                return
            yield cells

    def values(self, needed: Floats, box: Floats, cells: tuple[int, ...]) -> list[int]:
        """How many of each input: neighbours no farther apart than what the feedback makes of a cell."""
        apart = 2.0 * np.abs(self.shape.gain) @ (box / np.array(cells))
        between = [math.ceil(n / max(a, 1e-300)) for n, a in zip(needed, apart, strict=True)]
        return [min(MOST, max(self.least, 1 + 2 * n)) for n in between]

    def sought(self) -> Floats:
        """Half-widths of X where nothing limits it: what the motion depends on goes to REACH of its scale."""
        names, posture = self.model.state_names, self.posture
        positions = [names.index(c.position) for c in self.model.coordinates] or list(range(len(names)))
        measured = [j for j in positions if names[j] not in posture.free] or positions
        reach = REACH * np.minimum(posture.scale, 1.0)
        return np.asarray(self.shape.box / np.max((self.shape.box / reach)[measured]))

    def box(self, share: float) -> Floats:
        """Half-widths of X: as sought, and nothing beyond its room.

        Positions with a room keep out of its last step: the engine's stops are no part of the model. `share` is that
        of the inputs of a linear feedback.
        """
        names, box = self.model.state_names, self.sought()
        fits, needed = 1.0, self._travelled(box, share)
        for j, n in enumerate(names):
            lo, hi = self.room.get(n, (-math.inf, math.inf))
            fits = min(fits, min(hi - self.posture.x[j], self.posture.x[j] - lo) / (box[j] + needed[j]))
        return box * fits

    def _travelled(self, box: Floats, share: float) -> Floats:
        """How far positions go in one step from anywhere in the box, and a margin; 0 for velocities, (n,)."""
        names, tau, posture = self.model.state_names, self.shape.tau, self.posture
        gained = np.abs(posture.a) @ box + np.abs(posture.b) @ (share * np.abs(self.shape.gain) @ box)
        travel = np.zeros(len(names))
        for c in self.model.coordinates:
            v = names.index(c.velocity)
            travel[names.index(c.position)] = TRAVEL * tau * (box[v] + 0.5 * tau * gained[v])
        return travel

    def play(self, cells: tuple[int, ...], share: float, against: float = 0.0) -> Proposal:
        """The game on these cells with this share of the inputs of a linear feedback, X smaller where they are weak.

        `against` is the gap, as a share of what the largest inputs do in a step; beside it stands what friction leaves.
        """
        box = self.box(share)
        needed = share * np.abs(self.shape.gain) @ box
        most = beyond_rest(self.model, self.posture, self.limits)
        fits = min([1.0, *(most[needed > 0] / needed[needed > 0])])
        half = [rounded(v, math.floor) for v in box * fits]
        counts = self.values(needed, box, cells)
        steps = [step_of(*own) for own in zip(needed * fits, counts, most, strict=True)]
        x = self.posture.x
        space = Space(self.model.state_names, Box(x - half, x + half))
        every = [
            beside(u, s) + s * (np.arange(c) - c // 2) for u, s, c in zip(self.posture.u, steps, counts, strict=True)
        ]
        ends = dict(zip(space.states, zip(x - half, x + half, strict=True), strict=True))
        specification = Invariance(kind="invariance", safe=ends)
        problem = SynthesisProblem(self.sampled, specification, space, cells, np.array(list(itertools.product(*every))))
        inputs = tuple(s * (c // 2) for s, c in zip(steps, counts, strict=True))
        if against:
            spread = against * changed(self.sampled, self.posture, np.array(inputs))
            if self.rubs is None:
                both = beside_inputs(problem.inputs, spread)
                problem = replace(problem, inputs=both, gap=gap_beside_inputs(), gap_axes=[])
            else:
                kept = [j for j, n in enumerate(self.model.state_names) if n not in self.posture.free]
                problem = replace(problem, gap=self.rubs.gap(np.array(half), spread), gap_axes=kept)
        solution = specification.solve(problem.game())
        won = solution.fraction if solution.useful else 0.0
        sought = self.sought()
        shares = {"the joints' limits": float((box / sought).min()), "the inputs' limits": fits}
        return Proposal.of(
            self.model, self.posture, self.sampled.tau, cells, inputs, tuple(steps), tuple(half), won,
            float((np.array(half) / sought).min()), against=against, rubs=self.rubs is not None and against > 0.0,
            narrowed=(min(shares, key=shares.__getitem__),),
        )  # fmt: skip


HELD = 0.02
"""Of what the largest inputs do in a step: the gap against which the cells are to win as well, where time allows. On a
cart with a pole and a rubbing rail the cells that won for the model alone won nothing with the gap; with .01 of it they
are 2.5, with .02 six times as many, and with .04 none that a quick search affords."""
HELD_RUBBING = 0.016
"""The same beside what the dry friction of joints leaves (`rubbing`). Of two carts with a pole whose gap is known, the
cells that win are told by .016 from those that do not; with .013 it is wrong of one, with .02 of the other."""
WINS = 0.1
"""Share of the cells that has to win. Judgement: beside it a bound of the gap still leaves some."""
SECONDS = 120.0
"""Of CPU time, for the whole search. Judgement."""


def propose(
    model: SymbolicModel,
    sampled: Callable[[float], NominalModel],
    at: Mapping[str, float],
    limits: Mapping[str, float],
    room: Mapping[str, tuple[float, float]],
    tell: Callable[[str], None] = lambda words: None,
    seconds: float = SECONDS,
    rubs: Mapping[str, float] | None = None,
) -> Proposal:
    """Numbers for a plant.

    Args:
        model: continuous. sampled: the nominal model over so many seconds.
        at: states of the posture around which to work, 0 where none is given.
        limits: for inputs that have one the largest size. room: for states that have one the interval to stay within;
            of a position these are stops, and X keeps a step's travel away from them.
        tell: hears what is being done. seconds: of CPU time, after which the best so far is taken.
        rubs: dry friction of joints, which the simulator has and the model lacks.

    Raises:
        UserError: a posture that no input holds, inputs that move nothing, a plant that no feedback holds, an X of next
            to no size, or too little won within the time and the pairs of cell and input that a quick search takes.
    """
    found = last_within(seconds, partial(_answers, model, sampled, at, limits, room, rubs), tell)
    if found is None:
        raise UserError(
            "not found in the time, which does not suffice for the coarsest cells", key="synthesis.cells",
            remedy="Search longer (--seconds).",
        )  # fmt: skip
    if isinstance(found, UserError):
        raise found
    return found


def _answers(
    model: SymbolicModel, sampled: Callable[[float], NominalModel], at: Mapping[str, float],
    limits: Mapping[str, float], room: Mapping[str, tuple[float, float]], rubs: Mapping[str, float] | None,
    tell: Callable[[str], None],
) -> Iterator[Proposal | UserError]:  # fmt: skip
    """What `propose` answers where it has no more time: one answer after the other, each better than those before."""
    posture = posture_of(model, at)
    check_moved(model, posture)
    if is_driven(model):
        yield from driven(model, sampled, posture, limits, room, tell)
        return
    tell("searching for the sampling time and the shape of X")
    shape = _shape(model, posture)
    search = Search(model, sampled(shape.tau), posture, shape, limits, room, rubbing(model, posture, rubs, shape.tau))
    search.check()
    tried: list[Proposal] = []
    yield _too_few(search, tried, "the time is up in the first game")
    rounds = search.rounds()
    for cells in rounds:
        for share in SHARES:
            best = max((t.wins for t in tried), default=0.0)
            pairs = math.prod(cells) * search.least ** len(model.inputs) / 1e6
            so_far = f"; best so far {best:.2g}" if best else ""
            tell(f"trying {_shown(cells)} cells, {pairs:.2g} million pairs of cell and input{so_far}")
            tried.append(search.play(cells, share))
            if tried[-1].wins >= WINS:
                yield tried[-1]
                yield from _held(search, tried, share, [cells, *rounds], tell)
                return
            yield _too_few(search, tried, "the time is up")
    yield _too_few(search, tried, f"{'more' if tried else 'they'} are beyond a quick search", begin="Give")


def _too_few(
    search: Search, tried: Sequence[Proposal], why: str, begin: str = "Search longer (--seconds), give"
) -> UserError:
    most = max(tried, key=lambda t: (t.wins, math.prod(t.cells)), default=None)
    won = f"on {_shown(most.cells)} cells the nominal model alone wins {most.wins:.2g}" if most is not None else ""
    asked = f"by its linear model it takes about {search.shape.size:,.0f} cells at tau = {search.shape.tau:g} s"
    return UserError(
        "; ".join(filter(None, (won, asked, why))), key="synthesis.cells",
        remedy=f"{begin} it another input or stronger ones, or begin with fewer states.",
    )  # fmt: skip


def _held(
    search: Search, tried: list[Proposal], share: float, rounds: Sequence[tuple[int, ...]], tell: Callable[[str], None]
) -> Iterator[Proposal]:
    """What wins against a gap too, and then no more.

    Where joints rub there are more cells along their speeds, and inputs one size larger are tried as well; dry friction
    asks for more cells than the model alone, and the finest are the better answer before any win.
    """
    rubs, alone = search.rubs, tried[-1]
    shares = [share] if rubs is None else [s for s in SHARES if s >= share][:2]
    against, gap = (HELD, "a small gap") if rubs is None else (HELD_RUBBING, "dry friction")
    for cells, own in itertools.product(rounds, shares):
        fine = cells if rubs is None else rubs.finer(cells)
        tell(f"trying {_shown(fine)} cells against {gap}")
        tried.append(search.play(fine, own, against))
        if tried[-1].wins >= WINS:
            yield tried[-1]
            return
        if rubs is not None:
            yield replace(tried[-1], wins=alone.wins, against=0.0, rubs=False)


def _shown(cells: Sequence[int]) -> str:
    return " x ".join(map(str, cells))


def _shape(model: SymbolicModel, posture: Posture) -> Proportions:
    a = posture.a * posture.scale / posture.scale[:, None]
    b = posture.b * posture.strength / posture.scale[:, None]
    found = proportions(a, b, posture.rate)
    if found is None:
        raise UserError(
            f"no feedback was found that holds this posture: {unmoved(model, posture)}", key="plant.inputs",
            remedy="Give it another input, or another posture (--at).",
        )  # fmt: skip
    gain = posture.strength[:, None] * found.gain / posture.scale
    return replace(found, tau=rounded(found.tau), box=found.box * posture.scale, gain=gain)
