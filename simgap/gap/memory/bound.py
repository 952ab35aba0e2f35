"""The bound of a robot whose simulator has hidden state: hulls of all dimensions, widened, and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.gap import HiddenStateSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.fitting.acceptance import FreshCheck, check_sequences, confirmed, tolerate
from simgap.gap.memory.hidden_state import HistoryInfluence, HullFit, check_fading, tolerance_of
from simgap.gap.memory.search import SEARCH_LENGTH, BoundTable, HistorySearch, search
from simgap.gap.sampling.points import Columns, Points, body_samples
from simgap.gap.sampling.samples import previous_classes, read_back
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.plants.context import Context, pose_axes
from simgap.simulators.body_samples import REST
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import last_steps, open_robot
from simgap.statistics import TOP

SEARCH_SEED = 21
"""Of the first directed search; the second takes the next one."""
Attack = Callable[[BoundTable], HistorySearch]


@dataclass(frozen=True, eq=False)
class Robot:
    """The robot that the bound is about.

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
        gap: for the controller. table: the same with the swept boxes, as a search attacks it.
        largest: (3,) largest sampled body-frame gap over the grid of previous inputs.
        excess: (3,) largest excess of a random sequence over that hull; margin: (3,) what was added, by extrapolation.
        memory: (L, 3) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: between headings. searched: the directed search on the hull; None without one.
    """

    gap: BodyFrameGap
    table: BoundTable
    largest: Floats
    excess: Floats
    margin: Floats
    memory: Floats
    deviation: SymmetryDeviation
    searched: HistorySearch | None = None


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
    deviation = SymmetryDeviation(np.array([own.deviation for own in influences]), influences[0].compared)
    largest = np.maximum(np.abs(lower), np.abs(upper)).max(axis=(0, 1))
    check_fading(memory, largest, states, robot.growth, deviation.largest)
    swept = [own for k in pose[:2] if (own := hulls[k].swept) is not None]
    lo, hi = (np.stack([getattr(own, side) for own in swept], axis=-1) for side in ("lower", "upper"))
    excess, margin = (np.array([getattr(h.gap, name) for h in hulls]) for name in ("excess", "margin"))
    path_margin = np.array([own.margin for own in swept])
    hull = BoundTable(robot.classes, robot.motion, lower, upper, (lo, hi), pose)
    searched = attack(hull) if attack else None
    if searched is not None:
        excess = np.maximum(excess, searched.excess[:3])
        margin, path_margin = np.maximum(margin, searched.margin[:3]), np.maximum(path_margin, searched.margin[3:])
    raised = margin + deviation.largest
    tiers = _widening_tier(states, hulls[0], memory, excess, margin, searched), deviation.tier(states)
    added = path_margin + (float(np.max(deviation.largest[list(pose[:2])])) + robot.between_poses)
    table = replace(hull, lower=lower - raised, upper=upper + raised, swept=(lo - added, hi + added))
    gap = BodyFrameGap(robot.domain, tiers, table.lower, table.upper, pose, robot.classes)
    return HiddenStateFit(gap, table, largest, excess, margin, memory, deviation, searched)


def _widening_tier(
    states: Sequence[str], fit: HullFit, memory: Floats, excess: Floats, margin: Floats, searched: HistorySearch | None
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


Saved = Mapping[str, Mapping[str, Any]]
LONGER = "Raise hidden_state.chains, hidden_state.previous or hidden_state.search, or set \
hidden_state.tolerated_probability."


def hidden_bound(
    context: Context, motion: Floats, points: Points, scp: Saved, lipschitz: Saved, fresh: Columns
) -> tuple[dict[str, Any], FreshCheck]:
    """The content of gap.json, swept boxes included, and how the bound fared on fresh sequences; `motion` is (M, 3).

    Raises:
        BrokenPromise: a symmetry that does not hold, a memory that does not fade, violations on fresh sequences, or a
            directed search that breaks the bound.
    """
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    hulls = [read_back(HullFit.from_json, scp[n]) for n in context.states]
    influences = [read_back(HistoryInfluence.from_json, lipschitz[n]) for n in context.states]
    deviation = SymmetryDeviation(np.array([own.deviation for own in influences]), influences[0].compared)
    deviation.check(context.states, tolerance_of(context.states, symmetry.tolerance))
    attack = partial(_attack, context, hidden, SEARCH_SEED) if hidden.search else None
    fit = assemble_hulls(robot_of(context, hidden, motion), hulls, influences, attack)
    check = _check(context, fit, fresh)
    tolerate(check, hidden.tolerated_probability, LONGER)
    again = _attack(context, hidden, SEARCH_SEED + 1, fit.table) if hidden.search else None
    if again is not None and again.outside and hidden.tolerated_probability == 0.0:
        raise BrokenPromise(
            f"a directed search breaks the bound: {again.outside} of {again.evaluations} steps lie outside, the worst "
            f"after {again.worst[0]['inputs']} at heading {again.worst[0]['heading']:.6g}, by up to "
            f"{again.excess.tolist()}",
            LONGER,
        )
    return _content(context, fit, check, again, len(points.states), hulls[0].grid), check


def robot_of(context: Context, hidden: HiddenStateSection, motion: Floats) -> Robot:
    """The robot of a case; gravity, which limits what tyres can give, is the case's."""
    pose = pose_axes(context)
    free = tuple(sorted(pose[:2]))
    names = tuple(context.states), tuple(context.inputs)
    domain = GapDomain(*names, context.box, context.input_set, free, context.periodic)
    simulator = context.need(context.case.simulator, "simulator")
    between = simulator.between_poses(context.domain.tau, context.case.plant.gravity)
    return Robot(domain, motion, between, hidden.growth, previous_classes(context), pose)


def _attack(context: Context, hidden: HiddenStateSection, seed: int, table: BoundTable) -> HistorySearch:
    job = context.case, context.folder, table, context.input_set, SEARCH_LENGTH, hidden.search, seed
    (found,) = run_in_processes(search_in_engine, [job])
    return found


def search_in_engine(
    case: Case, folder: Path, table: BoundTable, inputs: Floats, length: int, budget: int, seed: int
) -> HistorySearch:
    """Run in the engine's process; see `hidden_search.search`."""
    with open_robot(case, folder) as robot:
        steps = partial(last_steps, robot, inputs=inputs)
        return search(table, steps, inputs, length, budget, np.random.default_rng(seed))


def _check(context: Context, fit: HiddenStateFit, fresh: Columns) -> FreshCheck:
    """Fresh sequences against the bound after their previous inputs, in the robot's frame, and against swept boxes.

    A sequence with any step outside counts as one failure: sequences are independent, their steps are not.

    Raises:
        UserError: a table that is not made of whole sequences.
    """
    samples = body_samples(context.case, fresh)
    begins = np.flatnonzero(samples.previous == REST)
    if len(begins) == 0 or begins[0] != 0:
        raise UserError("the fresh samples are not made of whole sequences", remedy="Run the stage fresh again.")
    excess = fit.table.excess(samples)
    return check_sequences(excess[:, :3], excess[:, 3:].max(axis=1), begins, context.states)


def _content(
    context: Context, fit: HiddenStateFit, check: FreshCheck, again: HistorySearch | None, previous: int, rolled: int
) -> dict[str, Any]:
    hidden = context.need(context.case.hidden_state, "hidden_state")
    tried = [] if again is None else [_attacked(again)]
    function = fit.gap.with_tiers([*confirmed(fit.gap.tiers, check), *tried, check.tier])
    (lower, upper), swept = (fit.table.lower, fit.table.upper), fit.table.swept
    size, width = np.maximum(np.abs(lower), np.abs(upper)), upper - lower
    suprema = function.sup()
    dimensions = [
        {
            "state": name,
            "largest_sampled_gap": float(fit.largest[i]),
            "sup_size": suprema[name].size,
            "sup_width": suprema[name].width,
            "mean_size": float(size[..., i].mean()),
            "mean_width": float(width[..., i].mean()),
            "beyond_previous_inputs": float(fit.excess[i]),
            "margin": float(fit.margin[i]),
        }
        for i, name in enumerate(context.states)
    ]
    return {
        **function.to_json(),
        "swept_boxes": {"lower": swept[0].min(axis=0), "upper": swept[1].max(axis=0)},
        "swept_boxes_by_class": {"lower": swept[0], "upper": swept[1]},
        "samples": rolled,
        "dimensions": dimensions,
        "memory": fit.memory,
        "heading_deviation": fit.deviation.largest,
        "budget": {
            "previous_inputs": previous,
            "random_sequences": hidden.chains,
            "steps_of_each": hidden.chain_length,
            "directed_steps": hidden.search,
            "substeps": context.case.simulator.substeps if context.case.simulator else None,
        },
        "directed_search": {
            "widened_by": fit.searched.to_json() if fit.searched else None,
            "tried_to_break": again.to_json() if again else None,
        },
        "fresh": asdict(check),
    }


def _attacked(again: HistorySearch) -> Tier:
    return Tier(
        3,
        f"A directed search with a seed of its own tried to break the bound in {again.evaluations:,} steps over "
        f"histories and headings: {again.outside} of them lie outside. A larger search might find more.",
    )
