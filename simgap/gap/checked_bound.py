"""Step `gap`: the fits of all dimensions put together, padded, checked on fresh samples and reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.function import GapFunction, Tier
from simgap.gap.fitting.acceptance import (
    BorderCheck,
    FreshCheck,
    check_fresh,
    confirmed,
    covering_remainder,
    none_outside,
    remedy,
    tolerate,
)
from simgap.gap.fitting.dimension_fit import DimensionFit, Sides, fit_from_json
from simgap.gap.fitting.force_reversal import staircase_height, staircase_tier
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import DimensionLipschitz, GridLipschitz, LipschitzRow
from simgap.gap.memory.bound import hidden_bound
from simgap.gap.memory.hidden_state import tolerance_of
from simgap.gap.noise import statement_of
from simgap.gap.sampling.borders import (
    CHECK,
    MAKE_BORDERS,
    NO_BORDERS,
    SHIFTED,
    border_gaps,
    border_states,
    stops_of,
    switching_surfaces,
)
from simgap.gap.sampling.points import (
    AFTER_PREVIOUS,
    Columns,
    Points,
    Step,
    free_axes,
    gap_ends,
    known_radius,
    remembers,
)
from simgap.gap.sampling.samples import (
    SampleGrid,
    check_drawn,
    motion_of,
    read_back,
    sample_grid,
    steps_of,
)
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.gap.thresholds import GATE
from simgap.plants.context import Context
from simgap.simulators.findings import to_stop

THINNED = 20_000  # samples kept for pictures
REMEMBERED = Tier(
    2,
    "Delay or lag of the inputs is not in the nominal model: the bound is the hull over what the least and the largest "
    "admissible earlier commands leave behind in the simulator. That nothing in between does more is an estimate, "
    "checked on fresh samples with random earlier commands.",
)
FINER = (
    "Use a finer grid, a smaller eps or half-widths (`simgap refine` says along which states), or set "
    "gap.tolerated_probability."
)
MORE_DRAWS = (
    "More fresh samples (gap.fresh_samples) confirm a smaller share; if they do not, the quantiles of the noise change "
    "more between samples than their extremes do: use a finer grid, or a smaller gap.noise.alpha."
)


@dataclass(frozen=True, eq=False)
class Made:
    """Results of the steps before this one.

    Attributes:
        points: the grid. scp, lipschitz: saved results by state. shards: roll-outs, for pictures.
        fresh: samples that no fit has seen.
        borders: samples on borders and beside switching surfaces; a case with hidden state has none.
    """

    points: Points
    scp: Mapping[str, Mapping[str, Any]]
    lipschitz: Mapping[str, Mapping[str, Any]]
    shards: Sequence[Columns]
    fresh: Columns
    borders: Columns | None = None


@dataclass(frozen=True, eq=False)
class Bound:
    """Content of gap.json, how it fared on the fresh samples, and evenly spaced samples with their gap for pictures."""

    content: dict[str, Any]
    check: FreshCheck
    thinned: dict[str, Floats]


def gap(context: Context, made: Made) -> Bound:
    """The bound of all dimensions, checked against the fresh samples.

    Raises:
        UserError: results of another case.
        BrokenPromise: a Lipschitz constant that cannot be trusted, a symmetry or a fading that does not hold, or more
            violations than the case tolerates.
    """
    if remembers(context.case):
        motion = motion_of(context)
        content, check = hidden_bound(context, motion, made.points, made.scp, made.lipschitz, made.fresh)
        return Bound(content, check, _thinned_steps(context, motion, made.shards))
    section, where = context.need(context.case.gap, "gap"), sample_grid(context, made.points)
    result, added = _assembled(context, made, section, where)
    noise = statement_of(context.case, where.size)
    x, u, d, _ = gap_ends(context.plant.sampled.step, made.fresh, context.states, context.inputs)
    check_drawn(context, x, u)
    check = check_fresh(result.function, x, u, d, section.confidence)
    tolerate(check, *((section.tolerated_probability, FINER) if noise is None else (noise.alpha, MORE_DRAWS)))
    x, u, lower, upper = border_gaps(
        context, made.borders or {}, CHECK, border_states(context, made.points.name, CHECK)
    )
    found = check_fresh(result.function, x, u, lower, d_upper=upper)
    beside = BorderCheck(len(x), found.violations, len(switching_surfaces(context)), found.worst, found.outside)
    none_outside(beside)
    tiers = confirmed(result.function.tiers, check)
    if noise is not None:
        tiers = [Tier(1, noise.of_step), *(tier for tier in result.function.tiers if tier.level != 1)]
    elif made.shards and f"least_{context.states[0]}" in made.shards[0]:
        tiers.append(REMEMBERED)
    function = covering_remainder(result.function.with_tiers([*tiers, *added, check.tier, beside.tier]), section)
    eps, content = known_radius(made.points.name), result.to_json() | function.to_json()
    content |= ({} if eps is None else {"eps": eps}) | {"fresh": asdict(check), "borders": asdict(beside)}
    content |= {"noise": asdict(noise)} if noise is not None else {}
    if where.free or eps is None:
        moving = zip(context.states, where.moving_half_widths.tolist(), strict=True)
        content["half_widths"] = {name: h for name, h in moving if h > 0}
    return Bound(content, check, _thinned(context, context.plant.sampled.step, where.size, made.shards))


def _assembled(
    context: Context, made: Made, section: GapSection, where: SampleGrid
) -> tuple[GapResult, list[Tier]]:  # fmt: skip
    """The bound before it is checked, and statements on what was added to it: a staircase, a symmetry's deviation."""
    names = context.states
    fits = [read_back(fit_from_json, made.scp[n]) for n in names]
    known = [read_back(DimensionLipschitz.from_json, made.lipschitz[n]) for n in names]
    if made.borders is None:
        raise UserError(NO_BORDERS, remedy=MAKE_BORDERS)
    added, tiers = [], []
    stair = staircase_height(context) if where.known is None else None
    if stair is not None:
        added.append(stair)
        tiers.append(staircase_tier(context, stair))
    shifts = _shifts(context, made.points.name, made.borders)
    if shifts is not None:
        added.append(shifts.largest)
        tiers.append(shifts.tier(names))
    return assemble(where, section, fits, known, np.sum(added, axis=0) if added else None), tiers


def _shifts(context: Context, name: str, borders: Columns) -> SymmetryDeviation | None:
    """Deviation of the gap along the axes of a declared translation; None without one.

    Raises:
        BrokenPromise: by more than the case tolerates.
    """
    if not free_axes(context.case):
        return None
    _, _, lower, upper = border_gaps(context, borders, SHIFTED, border_states(context, name, SHIFTED))
    found = SymmetryDeviation.of_translation(context, lower, upper)
    symmetry = context.need(context.case.symmetry, "symmetry")
    found.check(context.states, tolerance_of(context.states, symmetry.tolerance), reached_stops(context, found.along))
    return found


def seeds(context: Context) -> dict[str, int]:
    """Seeds of everything random in a bound."""
    hidden, section = context.case.hidden_state, context.case.gap
    if hidden is not None:
        return {"histories": hidden.seed, "fresh": hidden.fresh_seed}
    section = context.need(section, "gap")
    return {"fresh": section.seed, "fit": section.seed}


def _thinned(context: Context, step: Step, count: int, shards: Sequence[Columns]) -> dict[str, Floats]:
    """Evenly spaced ones of `count` samples with their gap."""
    rows, parts, first = _evenly(count), [], 0
    for shard in shards:
        end = first + len(shard[context.inputs[0]])
        own = rows[(rows >= first) & (rows < end)] - first
        parts.append({name: values[own] for name, values in shard.items()})
        first = end
    kept = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    x, u, d, upper = gap_ends(step, kept, context.states, context.inputs)
    d[1::2] = upper[1::2]  # both ends of a range are seen
    columns = {n: x[:, j] for j, n in enumerate(context.states)} | {n: u[:, j] for j, n in enumerate(context.inputs)}
    return columns | {f"gap_{n}": d[:, j] for j, n in enumerate(context.states)}


def _evenly(count: int) -> Any:
    return np.unique(np.linspace(0, count - 1, min(count, THINNED)).astype(int))


def _thinned_steps(context: Context, motion: Floats, shards: Sequence[Columns]) -> dict[str, Floats]:
    """The same for a robot, whose gap is seen from the robot."""
    samples = steps_of(context, shards, AFTER_PREVIOUS)
    rows = _evenly(len(samples.m))
    m = samples.m[rows]
    columns = {n: np.zeros(len(rows)) for n in context.states}
    columns |= {n: context.input_set[m, j] for j, n in enumerate(context.inputs)}
    d = samples.final[rows] - motion[m]
    return columns | {f"gap_{n}": d[:, j] for j, n in enumerate(context.states)}


def reached_stops(context: Context, states: Sequence[str]) -> list[str]:
    """The states that come within a step's travel of a stop, each with its joint and the stops, in words."""
    return [
        f"joint '{joint}' ({name} in [{lo:g}, {hi:g}], stops at {' and '.join(f'{end:g}' for end in ends)})"
        for joint, name, ends in stops_of(context)
        for lo, hi in [context.domain.X[name]]
        if name in states and any(to_stop(context.case, name, end) for end in ends)
    ]


@dataclass(frozen=True, eq=False)
class DimensionReport(JsonRecord):
    """Bound, slopes and programs of one dimension.

    Attributes:
        largest_sampled_gap: largest |d|. sup_size, sup_width: see `GapSuprema`; the first over the largest sample.
        mean_size, mean_width: means of max(|lo|, |hi|) and of hi - lo over X x U, see `_means`.
        lipschitz, lipschitz_estimates: of its Lipschitz constant.
        scenario: fitted sides by name (`upper` and `lower`, or `both`), empty for bounds without a program.
    """

    state: str
    largest_sampled_gap: float
    sup_size: float
    sup_width: float
    sup_over_largest_sample: float
    mean_size: float
    mean_width: float
    lipschitz: GridLipschitz
    lipschitz_estimates: tuple[LipschitzRow, ...]
    scenario: Sides = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GapResult:
    """A fitted gap function with its reports, one for each dimension."""

    function: GapFunction
    dimensions: tuple[DimensionReport, ...]
    samples: int

    def to_json(self) -> dict[str, Any]:
        """The content of gap.json."""
        return {
            **self.function.to_json(),
            "samples": self.samples,
            "dimensions": [d.to_json() for d in self.dimensions],
        }


def assemble(
    where: SampleGrid, settings: GapSection, fits: Sequence[DimensionFit], lipschitz: Sequence[DimensionLipschitz],
    deviation: Floats | None = None,
) -> GapResult:  # fmt: skip
    """The gap function of all dimensions, padded.

    `deviation`, (nx,), is added on both sides: by how much a declared symmetry does not hold, and its staircase.

    Raises:
        UserError: fits of different kinds.
        BrokenPromise: when the grid does not resolve the gap or a residual.
    """
    if len({type(fit) for fit in fits}) != 1:
        raise UserError("the fits of the dimensions are of different kinds", remedy="Run the scp stage again.")
    check_resolved(where, settings, lipschitz)
    function, sides = type(fits[0]).bound(fits, where, settings, lipschitz)
    if deviation is not None:
        function = function.raised(deviation, deviation)
    return GapResult(function, _reports(where, settings, function, lipschitz, sides), where.size)


def check_resolved(where: SampleGrid, settings: GapSection, lipschitz: Sequence[DimensionLipschitz]) -> None:
    """Refuse where the grid does not resolve the gap and the padding has no local jump bound for it.

    Raises:
        BrokenPromise: naming the state.
    """
    local = settings.padding == "inflate"
    for name, known in zip(where.states, lipschitz, strict=True):
        found = known.grid
        if local and found.rough_share <= settings.lipschitz.rough_limit:
            continue
        if local or not found.resolved:
            raise BrokenPromise(
                f"the gap of {name} is not Lipschitz at this grid: L(h/2)/L(h) = {found.ratio.max():.2f} > {GATE}, "
                f"{100 * found.rough_share:.2g} % of the cells are rough; "
                f"{found.place(where.states)}",
                remedy(where, settings, found, found.rough_share),
            )


def _reports(
    where: SampleGrid, settings: GapSection, function: GapFunction, lipschitz: Sequence[DimensionLipschitz],
    sides: Sequence[Sides],
) -> tuple[DimensionReport, ...]:  # fmt: skip
    suprema = function.sup()
    size, width = _means(where, function, settings.seed)
    reports = []
    for i, (state, known) in enumerate(zip(where.states, lipschitz, strict=True)):
        sup, largest, means = suprema[state], known.largest, (float(size[i]), float(width[i]))
        ratio = sup.size / largest if largest > 0.0 else float("inf")
        bound = state, largest, sup.size, sup.width, ratio, *means
        reports.append(DimensionReport(*bound, known.grid, known.estimates, sides[i]))
    return tuple(reports)


def _means(where: SampleGrid, function: GapFunction, seed: int, chunk: int = 200_000) -> tuple[Floats, Floats]:
    """(nx,), (nx,) means of max(|lo|, |hi|) and hi - lo over X x U: one random point of each cell for each input."""
    x, m, rng = where.grid.centres(), len(where.inputs), np.random.default_rng([seed, 1])
    size, width = np.zeros(len(where.states)), np.zeros(len(where.states))
    step = max(1, chunk // m)
    for a in range(0, len(x), step):
        part = np.repeat(x[a : a + step], m, axis=0)
        part += where.grid.h * rng.uniform(-1.0, 1.0, part.shape)
        lo, hi = function.bounds(part, np.tile(where.inputs, (len(part) // m, 1)))
        size += np.maximum(np.abs(lo), np.abs(hi)).sum(axis=0)
        width += (hi - lo).sum(axis=0)
    return size / (len(x) * m), width / (len(x) * m)
