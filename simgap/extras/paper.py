"""The paper's printed numbers beside what they imply and what is measured here.

Equations and tables are those of the paper's case studies ("Pendulum System", "Turtlebot Model").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.load import load_case, read_yaml
from simgap.errors import UserError
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.linear import Basis, Form, LinearGap, make_form, negated, supremum
from simgap.gap.sampling.points import product
from simgap.geometry import Box, Grid
from simgap.io.results import write_json
from simgap.late import sympy as sp
from simgap.model.expressions import parse
from simgap.plants.context import Context
from simgap.provenance import file_digest, provenance
from simgap.report.scene import limits
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.stages import log
from simgap.synthesis.synthesise import SynthesisProblem, synthesise


@dataclass(frozen=True)
class Row:
    """One line of the table: a printed number beside a reproduced one; None where there is nothing to print."""

    quantity: str
    printed: float | None
    reproduced: float | None
    note: str = ""


def printed_gap(domain: GapDomain, gamma: Mapping[str, str]) -> LinearGap:
    """`|d_i| <= gamma_i` from printed polynomials, one per state."""
    names = (*domain.states, *domain.inputs)
    parts = {s: sp.expand(parse(gamma[s], names)).as_coefficients_dict() for s in domain.states}
    monomials = sorted({m for p in parts.values() for m in p}, key=str)
    basis = Basis(tuple(str(m).replace("**", "^") for m in monomials), domain.states, domain.inputs)
    forms = []
    for s in domain.states:
        coefficients = np.array([float(parts[s].get(m, 0.0)) for m in monomials])
        forms.append(make_form(basis, domain.box, domain.input_set, coefficients))
    return LinearGap.unsigned(domain, (Tier(2, "As printed in the paper; not checked."),), forms)


def ends(form: Form, domain: GapDomain) -> tuple[float, float]:
    """Infimum and supremum of a printed function over X x U, to 1e-7."""
    return -supremum(negated(form), domain.input_set)[1], supremum(form, domain.input_set)[1]


def slope_bound(form: Form, domain: GapDomain, part: Box) -> float:
    """Euclidean Lipschitz constant of a printed function over a part of X, by the corners of its gradient's range."""
    smaller = make_form(form.basis, part, domain.input_set, form.coefficients)
    return float(np.linalg.norm(smaller.gradient_bound))


def _constant(form: Form) -> float:
    return float(sum(c for c, t in zip(form.coefficients, form.basis.terms, strict=True) if t == "1"))


def allowed(context: Context, domain: GapDomain, gamma: Mapping[str, str], threads: int = 1) -> dict[str, Any]:
    """Result of synthesis with the printed gamma: cells, target cells among them, and the refusal if there is one.

    An empty domain is a result here, not an error.
    """
    section = context.need(context.case.synthesis, "synthesis")
    problem = SynthesisProblem(
        model=context.plant.sampled,
        specification=specification_of(context.case),
        space=Space.of(context.case),
        cells=section.cells,
        inputs=context.input_set,
        gap=printed_gap(domain, gamma).kernel(),
        gap_axes=[] if domain.free else None,
    )
    try:
        solution, reason = synthesise(problem, threads), ""
    except UserError as error:
        solution, reason = problem.specification.solve(problem.game(threads)), str(error)
    target = int(solution.target.sum()) if solution.target is not None else 0
    won, free = int(solution.winning.sum()), int(solution.free.sum())
    return {"winning": won, "target": target, "free": free, "reason": reason}


POINTS = 81  # states per axis of the small grid on which PyBullet's gap is measured


def measured_gap(context: Context, pendulum: Path, engine_log: Path | None) -> tuple[Floats, Floats]:
    """Largest |d_i| of PyBullet's default set-up on a grid of X and all of U, and largest slope between neighbours.

    By state, (nx,) each. `pendulum` is the case with that set-up.
    """
    grid = Grid(Box(context.box.lo, context.box.hi), (POINTS, POINTS))
    x, u = product(grid.centres(), context.input_set)
    job = (load_case(pendulum), pendulum.parent, x, u)
    ((following, _),) = run_in_processes(roll_out, [job], log=engine_log)
    d = (following - context.plant.sampled.step(x, u)).reshape(POINTS, POINTS, -1, 2)
    slopes = [np.abs(np.diff(d, axis=j)).max(axis=(0, 1, 2)) / (2.0 * grid.h[j]) for j in range(2)]
    return np.abs(d).max(axis=(0, 1, 2)), np.hypot(*slopes)


def pendulum_rows(
    context: Context, domain: GapDomain, printed: Mapping[str, Any], largest: Floats, lipschitz: Floats
) -> list[Row]:
    """The pendulum's table.

    Args:
        context, domain: the paper's case; printed: `pendulum` of configs/paper/printed.yaml.
        largest, lipschitz: as `measured_gap`.
    """
    gamma, q = (printed_gap(domain, printed[key]).upper for key in ("gamma", "q"))
    eta, one, two = (printed[key] for key in ("eta", "L1", "L2"))
    stated, fitting = float(printed["eps"]), float(printed["eps_of_the_constants"])
    rows, tau = list[Row](), context.domain.tau
    for i, s in enumerate(domain.states):
        pad, constant, own = float(one[s]) + float(two[s]), _constant(q[i]), _constant(gamma[i])
        of_safe = slope_bound(q[i], domain, limits(context))
        lowest, highest = ends(gamma[i], domain)
        rows += [
            Row(f"eta_{i + 1}", float(eta[s]), float(largest[i]), "largest |d| in PyBullet, default flags"),
            Row(f"L1^({i + 1})", float(one[s]), float(lipschitz[i]), "of the measured gap"),
            Row(f"L2^({i + 1})", float(two[s]), of_safe, "analytic, of q.p on the safe set"),
            Row(f"constant of gamma_{i + 1}", own, constant + pad * stated, f"eps = {stated:g} as stated"),
            Row(f"constant of gamma_{i + 1}", own, constant + pad * fitting, f"eps = {fitting:g}"),
            Row(f"least q_{i + 1}.p on X", None, ends(q[i], domain)[0], "must cover |d|, so must not be negative"),
            Row(f"least gamma_{i + 1} on X", None, lowest, "must not be negative"),
        ]
        suprema = {e["eps"]: e[s] for e in printed["suprema"]}
        rows += [Row(f"sup gamma_{i + 1}, eps = {eps}", e, highest, "printed formula") for eps, e in suprema.items()]
    symbolic = context.need(context.case.plant.symbolic, "plant.symbolic")
    g, length = (symbolic.parameters[name].value for name in ("g", "l"))
    rows.append(Row("L1^(1), theory", float(one["x1"]), 1.5 * tau**2 * g / length, "tau^2 3 g / (2 l)"))
    note = "at the smallest x1 of the set tau x2 >= gamma_1 must hold; beside it the printed supremum"
    reached = tau * float(domain.box.hi[1])
    rows.append(Row("largest gamma_1 any invariant set allows", ends(gamma[0], domain)[1], reached, note))
    return rows


def turtlebot_rows(domain: GapDomain, printed: Mapping[str, Any], tau: float) -> list[Row]:
    """The robot's table: the printed gap against the longest step."""
    gamma = printed_gap(domain, printed["gamma"]).upper
    linear, angular = np.abs(domain.input_set).max(axis=0) * tau
    return [
        Row(f"least gamma_{i + 1}", ends(gamma[i], domain)[0], float(step), "beside it the longest nominal step")
        for i, step in enumerate((linear, linear, angular))
    ]


def table(content: Mapping[str, Any]) -> str:
    """Lines of text: what the printed bounds allow, and printed beside reproduced numbers."""
    lines = []
    for name, part in content.items():
        found = part["allowed"]
        lines.append(
            f"{name}: with the printed gamma {found['winning']:,} of {found['free']:,} free cells win"
            + (f", {found['target']:,} of them the target itself" if found["target"] else "")
        )
        for row in part["rows"]:
            printed, own = (f"{row[k]:.6g}" if row[k] is not None else "-" for k in ("printed", "reproduced"))
            note = f"  ({row['note']})" if row["note"] else ""
            lines.append(f"  {row['quantity']}: printed {printed}, reproduced {own}{note}")
    return "\n".join(lines)


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
        context, own = Context.load(folder / printed[name]["case"]), printed[name]
        free = (0, 1) if name == "turtlebot" else ()  # axes that the printed functions do not name
        states, inputs = tuple(context.states), tuple(context.inputs)
        domain = GapDomain(states, inputs, context.box, context.input_set, free, context.periodic)
        found = allowed(context, domain, own["gamma"], threads)
        counts = [found[key] for key in ("winning", "free", "target")]
        log.info("%s: %d of %d free cells win, %d are the target", name, *counts)
        rows = (
            pendulum_rows(context, domain, own, *measured_gap(context, pendulum, engine_log))
            if name == "pendulum"
            else turtlebot_rows(domain, own, context.domain.tau)
        )
        content[name] = {"allowed": found, "rows": [asdict(r) for r in rows]}
    files = {name: file_digest(folder / name) for name in ("printed.yaml", *(own["case"] for own in printed.values()))}
    record = provenance("paper", load_case(pendulum), pendulum.parent, files=files)
    write_json(out, content | {"provenance": record})
    return content
