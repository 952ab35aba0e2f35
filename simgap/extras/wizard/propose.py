"""Stage `propose`: tau, X, U, grid and cells for a case, with which its nominal model wins something."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from simgap.config.case import Case
from simgap.errors import UserError
from simgap.extras.wizard.driven_arm import Proposal, rounded
from simgap.extras.wizard.proposal import SECONDS, WINS, blocks_along, propose
from simgap.io.pages import text
from simgap.notation import joined
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.synthesis.abstraction.cells import MAX_AXES

ALONG = {1: 200, 2: 40, 3: 10, 4: 10}
"""Cells of the grid of samples along each axis on which the gap may depend, for so many of them. Judgement: on 6 x 6
the gap of a two-link arm was refused, so few do not show how it bends."""
TOLERANCE = "1.0e-9"
"""Of a declared translation, in the unit of each state: rounding, and nothing of an engine that knows places apart."""
SMALL = 0.5
"""Share of the X that is sought below which it is called small. Judgement."""
DEGREE = {1: 3}
"""Of the basis, by the number of inputs, else 2: the programs take a time that grows with the square of its terms."""


@dataclass(frozen=True)
class Numbers:
    """A proposal as a case writes it: `proposal`, half-widths of the grid by state, and the basis.

    That is one of monomials of a `degree`, or of `blocks` along each state where joints rub.
    """

    proposal: Proposal
    half_widths: Mapping[str, float]
    degree: int
    blocks: tuple[int, ...] = ()

    @property
    def small(self) -> str:
        """What to know of an X that is much smaller than sought, in a sentence, or nothing."""
        part = self.proposal.part
        if part >= SMALL:
            return ""
        return (
            f"X is small: {part:.2g} of the desired width in one state, because of {joined(self.proposal.narrowed)}. "
            "Tau, X and U by hand may do better (docs/how-to/four_states.md)."
        )

    @property
    def doubtful(self) -> str:
        """What to know where a run may win nothing, in a sentence, or nothing."""
        if self.blocks and self.proposal.target is None and not self.proposal.rubs:
            why, better = "With the dry friction no cells of a quick search win", "Stronger drives or less friction"
        elif self.proposal.wins < WINS:
            why, better = f"{self.proposal.wins:.2g} of X is little", "Other inputs or another posture (--at)"
        else:
            return ""
        return (
            f"{why}: a run may end with an empty winning domain, whose page says what is missing. {better} may help; "
            "--seconds searches longer."
        )

    @property
    def wins(self) -> str:
        """What was won in the search, as a clause."""
        won = f"wins {self.proposal.wins:.2g} of X"
        against, coarser = self.proposal.against, " on coarser cells" if self.proposal.target is not None else ""
        if not against:
            return f"the nominal model alone {won}"
        beside = "what dry friction leaves and " if self.proposal.rubs else ""
        return f"the nominal model with {beside}a gap of {against:g} of the effect of the largest inputs {won}{coarser}"

    def block(self) -> str:
        """Sections of a case file."""
        found = self.proposal
        return text(
            "proposal.yaml.j2", tau=found.tau, X=shown(found.X), U=found.U, free=found.free,
            states=list(found.X), half_widths=self.half_widths, degree=self.degree, cells=found.cells,
            blocks=self.blocks, tolerance=TOLERANCE, wins=self.wins,
            target=None if found.target is None else shown(found.target),
        )  # fmt: skip


def run(path: Path, at: Mapping[str, float], tell: Callable[[str], None], seconds: float = SECONDS) -> Numbers:
    """Numbers for the plant of a case file; its U, where it has one, is taken for what the drives can do.

    Raises:
        UserError: as `numbers`.
    """
    until = time.process_time() + seconds
    context = Context.load(path)
    case = context.case
    U = case.domain.U if case.domain is not None else {}
    limits = {n: max(abs(u.list()[0]), abs(u.list()[-1])) for n, u in U.items()}
    with context.blame():
        return numbers(case, context.folder, at, limits, {}, tell, until, _rubs(case))


def _rubs(case: Case) -> dict[str, float]:
    """Dry friction by joint, as the simulator's section says."""
    effects = case.simulator.effects if case.simulator is not None else ()
    return {e.on: e.parameters["F_c"] for e in effects if e.name == "coulomb_friction"}


def numbers(
    case: Case, folder: Path, at: Mapping[str, float], limits: Mapping[str, float],
    room: Mapping[str, tuple[float, float]], tell: Callable[[str], None], until: float,
    rubs: Mapping[str, float] | None = None,
) -> Numbers:  # fmt: skip
    """Numbers for the plant of a case, with what is left `until` this process has had so much CPU time, s.

    The other arguments are those of `propose`, and the dry friction of joints that rub.

    Raises:
        UserError: a plant of more states than a controller covers, or one that `propose` refuses.
    """
    plant = PlantModel.of(case, folder)
    if len(case.plant.states) > MAX_AXES or not plant.carried.derived:
        raise UserError(
            f"a controller covers at most {MAX_AXES} states, with equations that are written out", key="plant.states",
            remedy="Leave states out, or fix joints.",
        )  # fmt: skip
    if not case.plant.inputs:
        raise UserError("the plant has no input", key="plant.inputs", remedy="Name the joints that have a drive.")
    model, left = plant.carried, until - time.process_time()
    found = propose(model, lambda tau: replace(plant, tau=tau).sampled, at, limits, room, tell, left, rubs)
    coordinates = {c.name: c.velocity for c in plant.carried.coordinates}
    rubbing = {coordinates[joint] for joint in rubs or {}}
    if rubs:
        driven = {n: rubs[i.joint] for n, i in case.plant.inputs.items() if i.joint is not None and i.joint in rubs}
        found = quickened(found, set(coordinates.values()), driven, limits, room)
    kept = [n for n in found.X if n not in found.free]
    along = cells_along(kept, rubbing)
    widths = {n: rounded((found.X[n][1] - found.X[n][0]) / (2 * along[n])) for n in kept}
    blocks = tuple(along.get(n, 1) for n in found.X) if rubbing else ()
    return Numbers(found, widths, DEGREE.get(len(case.plant.inputs), 2), blocks)


def cells_along(kept: Sequence[str], rubbing: Collection[str]) -> dict[str, int]:
    """Cells of the samples along each state on which the gap may depend; `rubbing` are speeds of joints that rub."""
    return blocks_along(kept, rubbing) if rubbing else dict.fromkeys(kept, ALONG.get(len(kept), 10))


def shown(values: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, ...]]:
    """Without the digits that only rounding has: a thousandth of the width is kept."""
    return {
        n: tuple(round(v, 3 - math.floor(math.log10(max(ends[1] - ends[0], 1e-12)))) for v in ends)
        for n, ends in values.items()
    }


TIMES = 7.0
"""Largest input over the dry friction that it has to overcome, at least. A two-link arm with 7 and 21 wins .84 of its
cells with the gap, one with 10 at both joints and an obstacle .54; with a fifth it does not move at all."""

_DRIVE = "drive gives", "Give it a stronger drive, or less friction."
_JOINT = (
    "joint's velocity limit is",
    "Is that its own limit (<limit velocity> of the URDF)? Else less friction, or tau, X, U by hand",
)
Range = tuple[float, float]


def quickened(
    found: Proposal, velocities: Collection[str], friction: Mapping[str, float], limits: Mapping[str, float],
    room: Mapping[str, Range],
) -> Proposal:  # fmt: skip
    """The proposal, faster if an input is less than TIMES the friction of its joint.

    Args:
        velocities: states that are speeds. friction: of the joint of each input that rubs. limits: largest inputs.
        room: for speeds that have one the interval to stay within.

    Raises:
        UserError: a drive that is too weak for its joint's friction, a speed that the joint does not allow, or a plant
            that is held at an unstable posture, whose time is its own.
    """
    half = {name: 0.5 * (hi - lo) for name, (lo, hi, _) in found.U.items()}
    ratio = {name: TIMES * force / half[name] for name, force in friction.items() if name in half}
    most = max(ratio, key=ratio.__getitem__, default=None)
    if most is None or ratio[most] <= 1.0:
        return found
    if found.target is None:
        if friction[most] <= 0.5 * half[most]:
            return found
        raise UserError(
            f"holding the posture takes {half[most]:.2g} of {most}, the dry friction there is {friction[most]:g}",
            key="friction", remedy="A linear feedback does not move such a joint: lower the friction, or put tau and U "
            "in by hand.",
        )  # fmt: skip
    s = math.sqrt(ratio[most])
    inputs, speeds = {}, {n: (s * found.X[n][0], s * found.X[n][1]) for n in velocities}
    for name, (lo, hi, step) in found.U.items():
        rest, steps = 0.5 * (lo + hi), round((hi - lo) / (2 * step))
        wide = rounded(step * s * s)
        inputs[name] = (round(rest - steps * wide, 12), round(rest + steps * wide, 12), wide)
    asked = {n: (max(abs(lo), abs(hi)), limits.get(n, math.inf), _DRIVE) for n, (lo, hi, _) in inputs.items()}
    asked |= {n: (hi, min(-room[n][0], room[n][1]), _JOINT) for n, (_, hi) in speeds.items() if n in room}
    for name, (needed, limit, (whose, remedy)) in asked.items():
        if needed > limit:
            raise UserError(
                f"for {TIMES:g} times the dry friction that {most} feels ({friction[most]:g}) the game takes {name} "
                f"up to {needed:.2g}, and the {whose} {limit:g}", key="friction", remedy=remedy,
            )  # fmt: skip
    target = {n: (s * lo, s * hi) if n in velocities else (lo, hi) for n, (lo, hi) in found.target.items()}
    return replace(found, tau=rounded(found.tau / s), X={**found.X, **speeds}, U=inputs, target=target)
