"""Content of a case's page about the audit: counts of the adversary beside those of random samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simgap.io.traces import GAP_AWARE, SIMULATOR
from simgap.notation import pretty_unit
from simgap.report.material import Material


def figures(m: Material) -> dict[str, Any] | None:
    """For `summary.json`: evaluations, steps, violations and witnesses; the steps against the disturbance apart."""
    if m.audit is None:
        return None
    return {
        **{key: m.audit[key] for key in ("evaluations", "steps", "violations", "witnesses")},
        "steps_against_the_disturbance": m.audit["closed_loop"]["disturbance"]["steps"],
        "largest_share": m.audit["gap"]["largest_share"],
    }


def attempts(audit: Mapping[str, Any]) -> int:
    """Steps of every kind in which the adversary looked for a violation."""
    return int(audit["evaluations"] + sum(loop["steps"] for loop in audit["closed_loop"].values()))


def sentence(m: Material) -> str:
    """One line for the verdict."""
    if m.audit is None:
        return ""
    loops = m.audit["closed_loop"]
    steps = sum(loop["steps"] for loop in loops.values())
    return (
        f"Adversary: {m.audit['violations']:,} violations in {m.audit['evaluations']:,} single steps that attack the "
        f"bound and {steps:,} closed-loop steps under the worst admissible inputs."
    )


def section(m: Material) -> dict[str, Any] | None:
    """Rows of random samples and of the adversary, where the worst step lies, and counts by search and rule."""
    if m.audit is None:
        return None
    loops, gap = m.audit["closed_loop"], m.audit["gap"]
    fresh, random = m.gap.get("fresh", {}), m.validation["controllers"][GAP_AWARE][SIMULATOR]
    rows = [
        ("gamma, single steps", "random", None, fresh.get("samples", 0), fresh.get("violations", 0)),
        ("gamma, single steps", "adversary", None, m.audit["evaluations"], gap["violations"]),
        ("closed loop in the simulator", "random starts, the controller's own choice", random["runs"],
         random["steps"], random["runs_that_violated_it"]),
    ]  # fmt: skip
    named = (("simulator", "closed loop in the simulator"), ("disturbance", "closed loop against the worst of gamma"))
    rows += [(what, "adversary", *(loops[k][n] for n in ("runs", "steps", "violations"))) for k, what in named]
    by = [(f"gamma: {name}", count) for name, count in gap["evaluations_by_search"].items()]
    for k, what in named:
        by += [(f"{what}: {name}", count) for name, count in loops[k]["steps_by_rule"].items()]
    columns = ("what", "how", "runs", "steps", "violations")
    return {"rows": [dict(zip(columns, row, strict=True)) for row in rows], "by": by, "place": _place(m)}


def _place(m: Material) -> str:
    gap = (m.audit or {})["gap"]
    if gap["largest_share"] is None:
        return ""
    units = m.context.units
    where = ", ".join(f"{n} = {x:.4g} {pretty_unit(units[n])}".strip() for n, x in gap["worst"].items())
    side = "inside" if gap["largest_share"] <= 0 else "outside"
    at = f" (at {where})" if m.context.case.hidden_state is None else ""
    return f"The worst step found{at} lies {side} the bound by {100 * abs(gap['largest_share']):.2g} % of its width."
