"""Stage `paper`: what the paper's printed gamma functions allow, and printed beside reproduced numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simgap.config.load import load_case, read_yaml
from simgap.gap.function import GapDomain
from simgap.geometry import Box, Floats, Grid
from simgap.io.documents import write_json
from simgap.paper import Row, allowed, pendulum_rows, printed_gap, turtlebot_rows
from simgap.simulators.process import run_in_processes
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages.context import Context, log
from simgap.stages.rollouts import product, roll_out
from simgap.synthesis.synthesise import Problem

POINTS = 81  # states per axis of the small grid on which PyBullet's gap is measured


def run(folder: Path, pendulum: Path, out: Path, threads: int = 2, engine_log: Path | None = None) -> Any:
    """Tabulate and synthesise.

    Args:
        folder: holds printed.yaml and the paper's two cases.
        pendulum: case whose simulator is PyBullet with its default inertia.
        out: JSON with one entry per case: `allowed` and `rows`.
    """
    printed = read_yaml(folder / "printed.yaml")
    content: dict[str, Any] = {}
    for name in ("pendulum", "turtlebot"):
        context = Context.load(folder / printed[name]["case"])
        domain = gap_domain(context, free=(0, 1) if name == "turtlebot" else ())
        found = allowed(posed(context, domain, printed[name]["gamma"]), threads)
        log.info("%s: %d of %d free cells win, %d are the target", name, found.winning, found.free, found.target)
        content[name] = {
            "allowed": asdict(found),
            "rows": [asdict(r) for r in rows(name, context, domain, printed, pendulum, engine_log)],
        }
    write_json(out, content)
    return content


def table(content: Mapping[str, Any]) -> str:
    """What the printed bounds allow and printed beside reproduced numbers, as lines of text."""
    lines = []
    for name, part in content.items():
        found = part["allowed"]
        lines.append(
            f"{name}: with the printed gamma {found['winning']:,} of {found['free']:,} free cells win"
            + (f", {found['target']:,} of them the target itself" if found["target"] else "")
        )
        lines += [_line(r) for r in part["rows"]]
    return "\n".join(lines)


def _line(row: Mapping[str, Any]) -> str:
    printed, found = (f"{row[k]:.6g}" if row[k] is not None else "-" for k in ("printed", "reproduced"))
    note = f"  ({row['note']})" if row["note"] else ""
    return f"  {row['quantity']}: printed {printed}, reproduced {found}{note}"


def gap_domain(context: Context, free: tuple[int, ...]) -> GapDomain:
    """X and U of a case; `free` axes are those that the printed functions do not name."""
    return GapDomain(tuple(context.states), tuple(context.inputs), context.box, context.input_set, free)


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


def rows(
    name: str, context: Context, domain: GapDomain, printed: Any, pendulum: Path, engine_log: Path | None
) -> list[Row]:
    """The table of one case."""
    if name == "turtlebot":
        return turtlebot_rows(domain, printed[name], context.domain.tau)
    values = (
        {n: p.value for n, p in context.case.plant.symbolic.parameters.items()} if context.case.plant.symbolic else {}
    )
    measured = measured_gap(context, pendulum, engine_log)
    return pendulum_rows(domain, printed[name], values["g"], values["l"], context.domain.tau, measured)


def measured_gap(context: Context, pendulum: Path, engine_log: Path | None) -> dict[str, Floats]:
    """Largest |d_i| and largest slope of d_i between neighbouring samples in PyBullet's default set-up."""
    case = load_case(pendulum)
    grid = Grid(Box(context.box.lo, context.box.hi), (POINTS, POINTS))
    x, u = product(grid.centres(), context.input_set)
    ((following, _),) = run_in_processes(roll_out, [(case, pendulum.parent, x, u)], log=engine_log)
    d = (following - context.plant.sampled.step(x, u)).reshape(POINTS, POINTS, -1, 2)
    slopes = [np.abs(np.diff(d, axis=j)).max(axis=(0, 1, 2)) / (2.0 * grid.h[j]) for j in range(2)]
    return {"gap": np.abs(d).max(axis=(0, 1, 2)), "L1": np.hypot(*slopes)}
