"""Stage `paper`: what the paper's printed gamma functions allow, and printed beside reproduced numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simgap.config.load import load_case
from simgap.config.load_yaml import read_yaml
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.points import product
from simgap.geometry import Box, Grid
from simgap.io.documents import write_json
from simgap.paper import Row, allowed, measured_gap, pendulum_rows, printed_gap, turtlebot_rows
from simgap.plants.context import Context
from simgap.provenance import file_digest, provenance
from simgap.report.scene import limits
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import log
from simgap.synthesis.synthesise import Problem

POINTS = 81  # states per axis of the small grid on which PyBullet's gap is measured


def run(folder: Path, pendulum: Path, out: Path, threads: int = 2, engine_log: Path | None = None) -> Any:
    """Tabulate and synthesise.

    Args:
        folder: holds printed.yaml and the paper's two cases.
        pendulum: case whose simulator is PyBullet with its default inertia.
        out: JSON with one entry per case, `allowed` and `rows`, and the provenance.
    """
    printed = read_yaml(folder / "printed.yaml")
    content: dict[str, Any] = {}
    for name in ("pendulum", "turtlebot"):
        context = Context.load(folder / printed[name]["case"])
        domain = gap_domain(context, free=(0, 1) if name == "turtlebot" else ())
        found = allowed(posed(context, domain, printed[name]["gamma"]), threads)
        log.info("%s: %d of %d free cells win, %d are the target", name, found.winning, found.free, found.target)
        rows = (
            pendulum_table(context, domain, printed[name], pendulum, engine_log)
            if name == "pendulum"
            else turtlebot_rows(domain, printed[name], context.domain.tau)
        )
        content[name] = {"allowed": asdict(found), "rows": [asdict(r) for r in rows]}
    write_json(out, content | {"provenance": made_of(folder, printed, pendulum)})
    return content


def made_of(folder: Path, printed: Mapping[str, Any], pendulum: Path) -> dict[str, Any]:
    """The record of what was read: the simulated case by its sections, the paper's own files by their bytes."""
    names = ["printed.yaml", *(own["case"] for own in printed.values())]
    return provenance(
        "paper", load_case(pendulum), pendulum.parent, files={name: file_digest(folder / name) for name in names}
    )


def gap_domain(context: Context, free: tuple[int, ...]) -> GapDomain:
    """X and U of a case; `free` axes are those that the printed functions do not name."""
    return GapDomain(
        tuple(context.states), tuple(context.inputs), context.box, context.input_set, free, context.periodic
    )


def posed(context: Context, domain: GapDomain, gamma: dict[str, str]) -> Problem:
    """The synthesis problem with the printed bound."""
    section = context.need(context.case.synthesis, "synthesis")
    return Problem(
        model=context.plant.sampled,
        specification=specification_of(context.case),
        space=Space.of(context.case),
        cells=section.cells,
        inputs=context.input_set,
        gap=printed_gap(domain, gamma).kernel(),
        gap_axes=[] if domain.free else None,
    )


def pendulum_table(
    context: Context, domain: GapDomain, printed: Mapping[str, Any], pendulum: Path, engine_log: Path | None
) -> list[Row]:
    """The pendulum's table, with the gap of PyBullet's default set-up rolled out on a grid of X and all of U."""
    case = load_case(pendulum)
    symbolic = context.need(context.case.plant.symbolic, "plant.symbolic")
    grid = Grid(Box(context.box.lo, context.box.hi), (POINTS, POINTS))
    x, u = product(grid.centres(), context.input_set)
    ((following, _),) = run_in_processes(roll_out, [(case, pendulum.parent, x, u)], log=engine_log)
    d = (following - context.plant.sampled.step(x, u)).reshape(POINTS, POINTS, -1, 2)
    constants = {name: p.value for name, p in symbolic.parameters.items()}
    return pendulum_rows(domain, printed, constants, limits(context), context.domain.tau, measured_gap(d, grid.h))
