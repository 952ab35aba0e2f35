"""Costs of the stages of a case: counts are exact, bytes and seconds are estimates from measured rates.

Bytes are of the arrays that a stage cannot do without; seconds are CPU seconds on one core. Of runs of a minute the sum
is right to a factor of 1.5 (docs/evidence/public_models.md has them side by side), of a stage alone to two or three.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

from simgap.config.case import Case
from simgap.config.controller import AuditSection
from simgap.errors import UserError
from simgap.gap.memory.search import SEARCH_LENGTH
from simgap.gap.noise import draws_at
from simgap.gap.sampling.borders import checked_at_most, thinned_count
from simgap.gap.sampling.points import covering_grid, covering_point, free_axes, own_point
from simgap.gap.thresholds import CHECK_LEVELS, MOST_BORDER_STATES
from simgap.geometry import Box, Grid
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import is_tabulated
from simgap.synthesis.games.nodes import MOST_KEPT

START = 1.2
"""CPU seconds that a stage takes to start: imports, compiled kernels read back; the nominal model comes on top."""
BYTES = 2.5e8
"""Memory of a stage with nothing in it."""
BESIDE, JOB = 7.0, 0.25
"""CPU seconds of `check`, `grid`, page and recording together, and of the workflow for each job: a case of 17 jobs."""
ROLLOUT = 3e-5
"""CPU seconds of an engine's step of a joint plant where the engine was not asked."""
SEED = 5e-5
"""CPU seconds of the seed of a step with noise."""
LOOP = 6e-6
"""CPU seconds of a closed-loop step beside the engine's."""
FIT, SLOPES, BOUND = 2e-6, 1e-6, 1e-6
"""CPU seconds a sample, of `scp` and `lipschitz` (one state) and of `gap` (one state)."""
PROGRAM, LARGE_PROGRAM = 5e-3, 8e-5
"""CPU seconds of the linear programs of one state, for each pair of terms of the basis, and each three of them where
that is more: 31 terms take 5 s, 49 take 6 s, 81 take 44 s, 121 more than 125 s."""
PAIR, OPERATION = 2e-7, 6e-9
"""CPU seconds a pair of cell and input, of a synthesis that ends; and of each operation by which f is enclosed over a
cell where that is done for every pair, since its tables would be too large."""
ROW_PAIR = 3e-9
"""The same where whole rows of cells are decided at once: a robot whose gap does not depend on where it stands."""
MARGIN = 4e-7
"""CPU seconds a pair of cell and input of the margins, by which gamma could grow in each cell, in `audit`."""
MARGIN_BYTES = 24
"""Bytes a cell and state of the margins, and as many again."""
SAMPLE_BYTES = 60
"""Bytes a sample and state that the stages from roll-outs to the bound hold."""


PACE = 5.1e-3
"""CPU seconds of `_compiled` on a machine on which the rates above hold. A pendulum and a joint of a UR5 took 1.81 and
1.72 times of them on two busy cores where it took 9.0e-3. For runs of other robots, which set nothing, `check` said .7
to 1.4 times of what they took, at loads from 7 to 20 (docs/evidence/public_models.md)."""
_TEXT = "\n".join(f"x{k} = (a[{k}] + b) * max(c, {k}) if d{k} else [y for y in e if y > {k}]" for k in range(300))


@dataclass(frozen=True)
class StageCost:
    """One stage: how many of what, CPU seconds, bytes, and the key that makes it cheaper.

    `at_most` marks what usually ends earlier, and is not checked against a budget.
    """

    stage: str
    count: int
    of: str
    seconds: float
    bytes: float
    key: str
    at_most: bool = False


def costs(
    context: Context, rollout: float | None = None, eps: float | None = None, build: float = 0.0, pair: float = PAIR,
    slower: float = 1.0,
) -> list[StageCost]:  # fmt: skip
    """The stages of a case, in order.

    Args:
        context: of a case with a domain.
        rollout: measured time of a roll-out of its simulator, s.
        eps: radius of the balls that cover X where it is not the case's own.
        build: measured time in which the nominal model is built, s; most stages build it.
        pair: `pair_seconds` of the nominal model, where it is built.
        slower: `slowness` of the machine as it is; what was measured has it in it.
    """
    rollout, startup = rollout / slower if rollout else ROLLOUT, START + build / slower
    seeded = rollout + (SEED if context.case.is_random else 0.0)
    found = [*_samples(context, rollout, eps, startup, seeded), *_control(context, seeded, startup, pair)]
    every = [*found, _beside(context, len(found))] if found else []
    return [replace(cost, seconds=slower * cost.seconds) for cost in every]


def slowness() -> float:
    """How many times the CPU time of these rates this machine takes now, with what else it does.

    Two hardware threads that share a core slow each other down, and CPU time counts that.
    """
    return sorted(map(_compiled, range(5)))[2] / PACE


def _compiled(_: int) -> float:
    began = time.process_time()
    compile(_TEXT, "pace", "exec")
    return time.process_time() - began


def _beside(context: Context, stages: int) -> StageCost:
    """Cost of what no stage computes."""
    shards = context.case.grid.shards if context.case.grid is not None else 2
    jobs = stages + 2 * (len(context.states) - 1) + shards + 4  # a state each in `scp`, `lipschitz`; two controllers
    of = "jobs started, check, page and recording"
    return StageCost("workflow", jobs, of, BESIDE + JOB * jobs, BYTES, "budget.time")


def affordable(context: Context, found: list[StageCost]) -> None:
    """Hold every stage against the budget.

    Raises:
        UserError: the first that is beyond it, with the key that makes it cheaper.
    """
    budget = context.case.budget
    for cost in found:
        if cost.at_most:
            continue
        over_memory, over_time = cost.bytes > budget.bytes, cost.seconds > 3600.0 * budget.time
        if over_memory or over_time:
            needs = [f"about {size(cost.bytes)}"] * over_memory + [f"about {duration(cost.seconds)}"] * over_time
            has = [size(budget.bytes)] * over_memory + [duration(3600.0 * budget.time)] * over_time
            problem = f"{cost.count:,} {cost.of} need {' and '.join(needs)}; the budget is {' and '.join(has)}"
            remedy = f"Ask for less there, or raise budget.{'memory' if over_memory else 'time'}."
            raise UserError(problem, file=context.path, key=cost.key, remedy=remedy)


def _samples(context: Context, rollout: float, eps: float | None, startup: float, seeded: float) -> Iterator[StageCost]:
    case, nx = context.case, len(context.states)
    if case.simulator is None:
        return
    if case.hidden_state is None:
        if case.grid is None:
            return
        count = _grid(context, eps).size * _inputs(case)
        key = "grid.half_widths" if case.grid.half_widths else "grid.eps"
        of, shards = "samples of X x U", case.grid.shards
    else:
        hidden = case.hidden_state
        parts = {name: hidden.classes.get(name, 1) for name in hidden.previous}
        before = math.prod(parts[name] * max(2, -(-n // parts[name])) for name, n in hidden.previous.items())
        count = before * _inputs(case) + hidden.chains * hidden.chain_length
        key, of, shards = "hidden_state.previous", "roll-outs after earlier inputs", 2
    held = BYTES + SAMPLE_BYTES * nx * count
    repeated = max(1, draws_at(case, count))
    words = f"draws of noise, {repeated:,} at each of {count:,} {of}" if case.is_random else of
    rolled = START * shards + count * repeated * rollout
    key_of = "gap.noise.alpha" if case.is_random else key
    yield StageCost("rollouts", count * repeated, words, rolled, BYTES + (held - BYTES) / shards, key_of)
    own, checks = ("gap", case.gap) if case.hidden_state is None else ("hidden_state", case.hidden_state)
    if checks is not None:
        more = BYTES + 16.0 * nx * checks.fresh_samples
        seconds = START + checks.fresh_samples * seeded
        yield StageCost("fresh", checks.fresh_samples, "fresh samples", seconds, more, f"{own}.fresh_samples")
    if case.hidden_state is None:
        free = free_axes(case)
        states = _grid(context, eps)
        fitted = thinned_count(states.cells, free, MOST_BORDER_STATES)
        checked = thinned_count([CHECK_LEVELS] * nx, free, checked_at_most(states.size))
        shifted = case.symmetry.histories * (1 + case.symmetry.headings) if case.symmetry is not None and free else 0
        beside = (fitted + checked + shifted) * _inputs(case)
        yield StageCost(
            "borders", beside, "samples on borders of X", startup + beside * repeated * rollout, 2 * BYTES, key
        )
    for stage, rate in (("scp", FIT), ("lipschitz", SLOPES), ("gap", BOUND)) if checks is not None else ():
        attacks = 0 if case.hidden_state is None or stage != "gap" else 2 * case.hidden_state.search
        terms = _terms(context) if stage == "scp" else 0
        program = max(PROGRAM * terms**2, LARGE_PROGRAM * terms**3)
        seconds = startup + nx * (count * rate + program) + attacks * (1 + SEARCH_LENGTH) * rollout
        cheaper = "gap.basis" if nx * program > 0.5 * seconds else key
        words = f"{of}, {terms} terms" if cheaper == "gap.basis" else of
        yield StageCost(stage, count, words, seconds, held, cheaper)


def _grid(context: Context, eps: float | None) -> Grid:
    case = context.case
    return covering_grid(case, context.box, own_point(case) if eps is None else covering_point(eps))


def pair_seconds(context: Context) -> float:
    """CPU seconds a pair of cell and input, by the nominal model of a case with a controller."""
    case, model = context.case, context.plant.sampled
    if case.synthesis is None or not context.plant.carried.derived:
        return PAIR
    space = Space.of(case)
    grid = space.grid(specification_of(case).region(space), case.synthesis.cells)
    if is_tabulated(model, grid, _inputs(case)):
        return PAIR
    kept = set(range(grid.box.size)) - set(free_axes(case))  # cells that differ along others share their boxes
    read = kept.union(*model.offset_axes, *(axes for row in model.jacobian_axes for axes in row))
    share = math.prod(n for j, n in enumerate(grid.cells) if j in read) / grid.size
    return PAIR + OPERATION * model.operations_of_an_image * share


def _control(context: Context, rollout: float, startup: float, pair: float) -> Iterator[StageCost]:
    case = context.case
    if case.synthesis is None:
        return
    cells, inputs = math.prod(case.synthesis.cells), _inputs(case)
    rows = inputs + 1 if case.sensing is not None and case.sensing.latency else 1
    if case.hidden_state is not None:
        rows *= math.prod(case.hidden_state.classes.values())  # nodes: a controller remembers the class
    states = specification_of(case).memory_states(Space.of(case))
    rows *= states  # and what a task has come to, each state several times
    packed = math.ceil(inputs / 8)
    a_cell = 9 + 8 * len(context.states) + (2 if case.synthesis.record == "one" else rows * packed)
    wheeled = case.plant.symbolic is not None and case.plant.symbolic.wheels is not None
    rate = ROW_PAIR if wheeled and not (case.sensing is not None and case.sensing.latency) else pair
    controllers = 2 if case.simulator is not None and (case.gap is not None or case.hidden_state is not None) else 1
    nodes = rows + (controllers - 1) * (1 if case.hidden_state is not None else rows)  # one knows no earlier input
    seconds = controllers * startup + rate * cells * inputs * nodes * min(states, 8)
    boxes = 8 * len(context.states) * cells * inputs
    kept = boxes if pair > PAIR and not _holds(case) and boxes <= 4 * MOST_KEPT else 0
    of = "pairs of cell and input" + " for each of two controllers" * (controllers > 1)
    yield StageCost(
        "synthesis", cells * inputs * rows, of, seconds, BYTES + a_cell * cells + kept, "synthesis.cells",
    )  # fmt: skip
    if case.validation is not None and case.simulator is not None:
        steps = (case.validation.count() + case.validation.baseline_count()) * case.validation.steps
        ends = not _holds(case)
        yield StageCost(
            "validation", steps, "closed-loop steps" + " at most" * ends, startup + steps * (rollout + LOOP), 2 * BYTES,
            "validation.starts", ends,
        )  # fmt: skip
    if case.simulator is not None:
        evaluations, attacked = (case.audit or AuditSection()).budget(case.hidden_state is not None)
        calls = evaluations + attacked * (1 if case.hidden_state is not None else 1 + inputs // 4)
        seconds = 3 * startup + calls * rollout + PAIR * cells + attacked * inputs * PAIR
        held = 2 * BYTES + (12.0 + packed) * cells
        if not wheeled:
            seconds, held = seconds + MARGIN * cells * inputs, held + MARGIN_BYTES * (1 + len(context.states)) * cells
        of, key = "steps of the adversary", "audit.evaluations"
        if held > 4 * BYTES or seconds > 2 * calls * rollout:  # most of it is not for the steps
            of, key = f"{of} on {cells:,} cells", "synthesis.cells"
        yield StageCost("audit", calls, of, seconds, held, key)


def _terms(context: Context) -> int:
    """Number of terms of a basis that is one; `check` tells of others."""
    section = context.case.gap
    if section is None:
        return 0
    kept = [j for j in range(len(context.states)) if j not in free_axes(context.case)]
    box = Box(context.box.lo[kept], context.box.hi[kept])
    try:
        return len(section.basis.listed([context.states[j] for j in kept], context.inputs, box))
    except UserError:
        return 0


def _holds(case: Case) -> bool:
    """True if runs go on for ever; asked of the section, so that what reads costs does not depend on its plug-in."""
    return bool(getattr(case.synthesis.specification, "holds", True)) if case.synthesis is not None else True


def _inputs(case: Case) -> int:
    assert case.domain is not None
    return math.prod(values.count for values in case.domain.U.values())


def size(count: float) -> str:
    """Bytes as a person says them."""
    for unit, scale in (("TiB", 2**40), ("GiB", 2**30), ("MiB", 2**20)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 2**10:.3g} KiB"


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    for unit, scale in (("years", 365.25 * 86400.0), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds:.3g} s"
