"""Stage `check`: what can be said of a case before anything long runs.

It reads the case and its model file, loads the engine once in a process of its own, and asks it what it made of the
file and how fast it steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from simgap import reading
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.gap.sampling.points import covering_grid, free_axes, own_point
from simgap.io.documents import write_json
from simgap.lint.angle_units import affordable_or_degrees, in_degrees, refuse_seams
from simgap.lint.between_samples import check_path
from simgap.lint.costs import StageCost, affordable, costs, duration, size
from simgap.lint.engine import of_engine
from simgap.lint.few_cells import refuse_few_cells
from simgap.lint.measured import check_measured, no_coordinates
from simgap.lint.mixed_units import mixed_units, refuse_prefixes, wrong_dimensions
from simgap.lint.sampling_time import long_steps
from simgap.lint.switching import stuck, sudden
from simgap.lint.wheel_sizes import wheel_sizes
from simgap.plants.context import Context
from simgap.plants.model_file import ModelFile, read_model_file
from simgap.provenance import provenance
from simgap.simulators.surprises import Finding
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import log
from simgap.stages.fair_baseline import minding_the_path
from simgap.synthesis.games.game import one_input_only
from simgap.synthesis.games.layer_tables import no_layers

HEAVY = 5_000
"""Operations to be compiled beyond which a person is warned; numba's time grows faster than their number. A Furuta
pendulum has 81 by explicit_euler and 74 by rk4, both compiled in seconds; 24,913 were not in 250 s."""


@dataclass(frozen=True)
class Checked:
    """What `check` found.

    Attributes:
        costs: of each stage; cells: of the grid of samples and of the controller, an axis each, by state.
        findings: what the engine makes of the model file in silence; compared: whether there is an engine that loads
            one, and was asked.
    """

    costs: list[StageCost]
    cells: dict[str, dict[str, int]]
    findings: list[Finding]
    compared: bool


def run(
    case_path: Path,
    out: Path | None = None,
    engine_log: Path | None = None,
    tell: Callable[[str], None] | None = None,
) -> Checked:
    """Check a case, and write what was found to `out` (JSON) if given; `tell` hears what is being done.

    Raises:
        UserError: whatever a stage would refuse later: keys, joints, units, meshes, basis symbols, recordings that are
            not what the case says, a specification that does not fit X, and a cost beyond the budget of the case.
    """
    context = Context.load(case_path)
    case = context.case
    with context.blame():
        said = tell or (lambda words: None)
        if case.domain is not None:
            first = costs(context)
            affordable_or_degrees(context, first)  # before anything that would build what is too large
            said(_outlook(first))
        file = model_file(context)
        of_angles = in_degrees(context, file.joints if file is not None else {})
        said(f"building the nominal model of {len(context.states)} states")
        check_measured(context)
        began = time.process_time()
        _ = context.plant.sampled if case.domain is not None else context.plant.declared
        build = time.process_time() - began
        refuse_prefixes(context)
        refuse_few_cells(context)
        refuse_seams(context)
        _specification(context)
        _basis(context)
        check_path(context)
        if case.simulator is not None:
            said(f"asking the engine {case.simulator.engine}")
        findings, rollout = of_engine(context, file, engine_log)
        of_wheels = wheel_sizes(context)  # of a file that the engine could load
        found = costs(context, rollout, build=build) if case.domain is not None else []
        affordable(context, found)
    compared = findings is not None
    of_equations = [*mixed_units(context), *wrong_dimensions(context)]
    of_case = [*of_equations, *heavy_steps(context), *long_steps(context), *of_wheels]
    of_case += [*of_angles, *sudden(context), *stuck(context), *no_coordinates(context)]
    result = Checked(found, _cells(context), [*(findings or []), *of_case], compared)
    for finding in result.findings:
        log.warning("%s: %s. %s", finding.key, finding.problem, finding.remedy)
    if out is not None:
        record = provenance("check", case, context.folder)
        write_json(out, {"case": case.name, **asdict(result), "provenance": record})
    return result


def heavy_steps(context: Context) -> list[Finding]:
    """A nominal step of so many operations that synthesis will take far longer than is estimated."""
    if context.case.synthesis is None:
        return []
    operations = context.plant.sampled.operations
    if operations <= HEAVY:
        return []
    return [
        Finding(
            "plant",
            f"a step of the nominal model has {operations:,} operations; compiling and asking it takes synthesis "
            "minutes to hours more than is estimated",
            "Leave out terms that matter little, or fix joints; what the model then misses is in the gap",
        )
    ]


def _outlook(found: list[StageCost]) -> str:
    """What a run will compute, in a line, before anything is built: the largest count and all seconds."""
    held = [cost for cost in found if not cost.at_most]
    if not held:
        return "nothing long to compute"
    most = max(held, key=lambda cost: cost.seconds)
    seconds = duration(sum(c.seconds for c in held))
    return f"about {seconds} of CPU time in all{_at_most(found)}, most of it {most.count:,} {most.of}"


def _at_most(found: list[StageCost]) -> str:
    """What comes on top of a total: stages that usually end earlier than their count says."""
    return "".join(f" and at most {duration(c.seconds)} more for {c.stage}" for c in found if c.at_most)


def conclusion(checked: Checked, case: Path) -> str:
    """What follows from a check, in a line: what a run will take and how it is begun."""
    held = [cost for cost in checked.costs if not cost.at_most]
    if not held:
        return f"The case is in order. simgap diagnose {case} takes recordings."
    seconds, most = sum(cost.seconds for cost in held), max(cost.bytes for cost in checked.costs)
    return (
        f"The case is in order. A run takes about {duration(seconds)} of CPU time{_at_most(checked.costs)}, and "
        f"{size(most)}: simgap run {case}"
    )


def model_file(context: Context) -> ModelFile | None:
    """The file that the simulator loads, its meshes there; the nominal model's where there is no simulator."""
    section, own = context.case.simulator, context.case.plant.urdf
    files = [name for name in (own, section.urdf if section is not None else None) if name is not None]
    read = [read_model_file(context.folder / name) for name in files]
    for file in read:
        for mesh in file.meshes:
            if mesh.startswith("package://"):
                continue  # found through the paths of a ROS installation, if at all
            if not reading.is_file(file.path.parent / mesh.removeprefix("file://")):
                raise UserError(
                    "the mesh does not exist", file=file.path, key=f"mesh '{mesh}'", remedy="Correct its path."
                )
    return read[-1] if read else None


def _specification(context: Context) -> None:
    if context.case.synthesis is None:
        return
    space, section = Space.of(context.case), context.case.synthesis
    region = specification_of(context.case).region(space)
    if len(section.cells) != region.size:
        raise UserError(
            f"{len(section.cells)} cell counts for {region.size} states", key="synthesis.cells",
            remedy="Give one for each state, in order.",
        )  # fmt: skip
    if context.case.validation is not None and context.case.validation.fair_baseline:
        minding_the_path(context)
    _recorded(context.case)
    _layered(context.case)


def _recorded(case: Case) -> None:
    """One input a cell is refused here where synthesis would refuse it after the roll-outs."""
    section, sensing = case.synthesis, case.sensing
    if section is None or section.record != "one":
        return
    specification = specification_of(case)
    blurred = sensing is not None and (sensing.latency > 0 or any(sensing.error.values()))
    obstacles = (
        (specification.holds, "a set that is to be held"),
        (section.rule != "least_effort", f"the rule `{section.rule}`"),
        (sensing is not None and sensing.latency > 0, "a controller that remembers the input under way"),
        (blurred and specification.on_true_cells, "cells of the true state"),
        (case.hidden_state is not None and case.hidden_state.classes, "a controller that remembers the input before"),
    )
    for stands, what in obstacles:
        if stands:
            raise one_input_only(what)


def _layered(case: Case) -> None:
    """Cells of several sizes are refused here where synthesis would refuse them after the roll-outs."""
    section, sensing = case.synthesis, case.sensing
    if section is None or section.layers == 1:
        return
    blurred = sensing is not None and (sensing.latency > 0 or any(sensing.error.values()))
    obstacles = (
        (not specification_of(case).holds, "what is to be reached"),
        (blurred, "a late measurement, or one with an error"),
        (case.hidden_state is not None and case.hidden_state.classes, "a controller that remembers the input before"),
        (case.domain is not None and case.domain.periodic, "states that wrap"),
    )
    for stands, what in obstacles:
        if stands:
            raise no_layers(what)


def _basis(context: Context) -> None:
    """Symbols that do not exist are found here and not after the roll-outs."""
    section = context.case.gap
    if section is None or section.bound not in ("scenario", "conformal") or context.case.domain is None:
        return
    from simgap.gap.bounds.forms import widened
    from simgap.gap.fitting.linear_fit import listed_basis  # takes a second: only paid by cases that get this far

    try:
        free = free_axes(context.case)
        basis = listed_basis(section.basis, context.states, context.inputs, context.box, free)
        _ = basis.ranges(widened(context.box), context.input_set)
    except UserError as error:
        raise UserError(error.problem, key=error.key or "gap.basis", remedy=error.remedy) from None


def _cells(context: Context) -> dict[str, dict[str, int]]:
    case = context.case
    found: dict[str, dict[str, int]] = {}
    if case.grid is not None and case.domain is not None and case.hidden_state is None:
        found["samples"] = dict(
            zip(context.states, covering_grid(case, context.box, own_point(case)).cells, strict=True)
        )
    if case.synthesis is not None:
        found["controller"] = dict(zip(context.states, case.synthesis.cells, strict=True))
    return found
