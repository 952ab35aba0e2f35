"""Stage `check`: what can be said of a case before anything long runs.

It reads the case and its model file, loads the engine once in a process of its own, and asks it what it made of the
file and how fast it steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from simgap.errors import Finding
from simgap.gap.sampling.points import covering_grid, own_point
from simgap.io.results import write_json
from simgap.lint import controller, engine, equations, gap, measured
from simgap.lint.costs import StageCost, affordable, costs, duration, pair_seconds, size, slowness
from simgap.plants.context import Context
from simgap.stages import log

Check = Callable[[Context], Iterable[Finding] | None]
"""Findings about a case; what no stage could use raises UserError with the key and the remedy."""

OF_CASE: tuple[Check, ...] = (
    equations.refuse_prefixes, gap.refuse_few_cells, equations.refuse_seams, controller.refuse_specification,
    gap.refuse_basis, controller.refuse_free_path,
)  # fmt: skip
"""Checks that take no engine; made first, since starting one takes seconds."""

OF_NUMBERS: tuple[Check, ...] = (
    equations.find_mixed_units, equations.find_wrong_dimensions, equations.find_heavy_steps, equations.find_long_steps,
    engine.find_bolted_base, engine.find_other_wheel_sizes, gap.find_jumps_at_rest, gap.find_stuck_joints,
    gap.find_noise, measured.find_missing_coordinates, controller.find_no_controller,
)  # fmt: skip
"""Checks once the engine has loaded its model file: its reasons come before those that follow from them."""


def run_checks(checks: tuple[Check, ...], context: Context) -> list[Finding]:
    """All that these checks find.

    Raises:
        UserError: the first refusal.
    """
    return [finding for check in checks for finding in check(context) or ()]


@dataclass(frozen=True)
class Checked:
    """Result of a check.

    Attributes:
        costs: of each stage; cells: of the grid of samples and of the controller, an axis each, by state.
        findings: what the engine makes of the model file in silence; compared: whether there is an engine that loads
            one, and was asked. recordings: how each one is read, in a line.
    """

    costs: list[StageCost]
    cells: dict[str, dict[str, int]]
    findings: list[Finding]
    compared: bool
    recordings: Sequence[str] = ()


def run(
    case_path: Path, out: Path | None = None, engine_log: Path | None = None, tell: Callable[[str], None] | None = None
) -> Checked:
    """Check a case, and write what was found to `out` (JSON) if given; `tell` hears what is being done.

    Raises:
        UserError: whatever a stage would refuse later: keys, joints, units, meshes, basis symbols, recordings that are
            not what the case says, a specification that does not fit X, and a cost beyond the budget of the case.
    """
    context = Context.load(case_path)
    case = context.case
    with context.blame():
        tell_user = tell or (lambda words: None)
        if case.domain is not None:
            affordable(context, costs(context))  # before what is too large would be built
        file = engine.model_file(context)
        of_angles = list(equations.find_degrees(context, file.joints if file is not None else {}))
        tell_user(f"building the nominal model of {len(context.states)} states")
        measured.check_measured(context)
        began = time.process_time()
        _ = context.plant.sampled if case.domain is not None else context.plant.declared
        build = time.process_time() - began
        run_checks(OF_CASE, context)
        if case.simulator is not None:
            tell_user(f"querying the engine {case.simulator.engine}")
        findings, rollout = engine.of_engine(context, file, engine_log)
        found = []
        if case.domain is not None:
            found = costs(context, rollout, build=build, pair=pair_seconds(context), slower=slowness())
        affordable(context, found)
        of_numbers = run_checks(OF_NUMBERS, context)
    every = [*(findings or []), *of_angles, *of_numbers]
    result = Checked(found, _cells(context), every, findings is not None, measured.as_read(context))
    for finding in result.findings:
        log.warning("%s: %s. %s", finding.key, finding.problem, finding.remedy)
    if out is not None:
        write_json(out, {"case": case.name, **asdict(result), "provenance": context.record("check")})
    return result


def conclusion(checked: Checked, case: Path) -> str:
    """One line about what follows from a check: what a run will take and how it is begun."""
    held = [cost for cost in checked.costs if not cost.at_most]
    if not held:
        return f"The case is in order. simgap diagnose {case} takes recordings."
    seconds, most = sum(cost.seconds for cost in held), max(cost.bytes for cost in checked.costs)
    more = "".join(f" and at most {duration(c.seconds)} more for {c.stage}" for c in checked.costs if c.at_most)
    return (
        f"The case is in order. A run takes about {duration(seconds)} of CPU time{more}, "
        f"and {size(most)}: simgap run {case}"
    )


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
