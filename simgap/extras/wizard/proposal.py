"""Sampling time, X, U and cells with which the nominal model of a plant wins something.

The linear model around a posture says how they have to be to each other (`proportions`); how strong the inputs have to
be for a box is found by solving the nominal model's own game on coarse cells, a few seconds each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from simgap.errors import UserError
from simgap.extras.wizard.budget import Budget
from simgap.extras.wizard.driven_arm import GUESS, Driven, driven, is_driven, rounded
from simgap.extras.wizard.dry_friction_guess import rubbing
from simgap.extras.wizard.no_proposal import check_moved, unmoved
from simgap.extras.wizard.posture import Posture, posture_of
from simgap.extras.wizard.proportions import Proportions, proportions
from simgap.extras.wizard.proposal_games import FEWEST, REACH, SHARES, Proposal, Search, Tried, beside
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel

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
        tell: hears what is being done. seconds: of CPU time, after which no other game is begun.
        rubs: dry friction of joints, which the simulator has and the model lacks.

    Raises:
        UserError: a posture that no input holds, inputs that move nothing, a plant that no feedback holds, an X of next
            to no size, or too little won within the time and the pairs of cell and input that a quick search takes.
    """
    budget = Budget(seconds)
    posture = posture_of(model, at)
    check_moved(model, posture)
    if is_driven(model):
        found = driven(model, sampled, posture, limits, room, tell, budget)
        return _of_driven(model, posture, found)
    tell("looking for the sampling time and the shape of X")
    shape = _shape(model, posture)
    search = Search(model, sampled(shape.tau), posture, shape, limits, room, rubbing(model, posture, rubs, shape.tau))
    search.check()
    tried: list[Tried] = []
    rounds = search.rounds()
    few = (FEWEST,) * len(model.states)
    budget.gauge(search.pairs(few, SHARES[0]), partial(search.play, few, SHARES[0]))
    for cells in rounds:
        for share in SHARES:
            if not budget.allows(search.pairs(cells, share)):
                break
            best = max((t.wins for t in tried), default=0.0)
            tell(f"a game of {_shown(cells)} cells" + (f"; best so far {best:.2g}" if best else ""))
            tried.append(budget.spent(search.pairs(cells, share), partial(search.play, cells, share)))
            if tried[-1].wins >= WINS:
                return search.proposal(_held(search, tried, share, [cells, *rounds], tell, budget), tried)
    if not tried:
        raise UserError(
            f"not found in the time: no game of the nominal model fits in {seconds:g} s", key="synthesis.cells",
            remedy="Search longer (--seconds).",
        )  # fmt: skip
    most = max(tried, key=lambda t: (t.wins, math.prod(t.cells)))
    raise UserError(
        f"on {_shown(most.cells)} cells the nominal model alone wins {most.wins:.2g}, and "
        f"{'the time is up' if budget.refused else 'more are beyond a quick search'}; by its "
        f"linear model it takes about {shape.size:,.0f} at tau = {shape.tau:g} s", key="synthesis.cells",
        remedy="Give it another input or stronger ones, or begin with fewer states.",
    )  # fmt: skip


def _held(
    search: Search, tried: list[Tried], share: float, rounds: Sequence[tuple[int, ...]],
    tell: Callable[[str], None], budget: Budget,
) -> Tried:  # fmt: skip
    """The first that win against a gap too.

    Where joints rub there are more cells along their speeds, and inputs one size larger are tried as well. If none win
    in time, what wins for the model alone: its own cells, or beside dry friction, which asks for more, the finest.
    """
    rubs, left = search.rubs, tried[-1]
    shares = [share] if rubs is None else [s for s in SHARES if s >= share][:2]
    against, gap = (HELD, "a small gap") if rubs is None else (HELD_RUBBING, "dry friction")
    for cells, own in itertools.product(rounds, shares):
        fine = cells if rubs is None else rubs.finer(cells)
        if not budget.allows(search.pairs(fine, own)):
            break
        tell(f"a game of {_shown(fine)} cells against {gap}")
        tried.append(budget.spent(search.pairs(fine, own), partial(search.play, fine, own, against)))
        if tried[-1].wins >= WINS:
            return tried[-1]
        left = left if rubs is None else replace(tried[-1], wins=left.wins, against=0.0)
    return left


def _shown(cells: Sequence[int]) -> str:
    return " x ".join(map(str, cells))


def _of_driven(model: SymbolicModel, posture: Posture, found: Driven) -> Proposal:
    x, names = posture.x, model.state_names
    X = {n: (float(x[j]) - found.half[j], float(x[j]) + found.half[j]) for j, n in enumerate(names)}
    U = {}
    for n, rest, most in zip(model.input_names, posture.u, found.inputs, strict=True):
        at = beside(rest, most / 2)
        U[n] = (round(at - most, 12), round(at + most, 12), round(most / 2, 12))
    part = min(1.0, *(found.half[names.index(c.position)] / REACH for c in model.coordinates))
    return Proposal(found.tau, X, U, found.cells, found.wins, posture.free, (), part, found.target, GUESS)


def _shape(model: SymbolicModel, posture: Posture) -> Proportions:
    a = posture.a * posture.scale / posture.scale[:, None]
    b = posture.b * posture.strength / posture.scale[:, None]
    found = proportions(a, b, posture.rate)
    if found is None:
        raise UserError(
            f"no feedback holds the plant at this posture: {unmoved(model, posture)}", key="plant.inputs",
            remedy="Give it another input, or another posture (--at).",
        )  # fmt: skip
    gain = posture.strength[:, None] * found.gain / posture.scale
    return replace(found, tau=rounded(found.tau), box=found.box * posture.scale, gain=gain)
