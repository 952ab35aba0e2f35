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
from simgap.gap.bounds.basis import Basis, Form, make_form, negated, supremum
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.linear import LinearGap
from simgap.gap.sampling.points import product
from simgap.geometry import Box, Grid
from simgap.io.documents import write_json
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


@dataclass(frozen=True, eq=False)
class Measured:
    """The gap of a simulator by state, (nx,): largest |d_i|, and largest slope between neighbouring samples."""

    largest: Floats
    lipschitz: Floats


@dataclass(frozen=True)
class Allowed:
    """Result of synthesis with the printed gamma: cells, target cells among them, and the refusal if there is one."""

    winning: int
    target: int
    free: int
    reason: str


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


def measured_gap(d: Floats, h: Floats) -> Measured:
    """Largest gap and slope of a gap sampled on a grid.

    Args:
        d: (n1, n2, M, nx) gap on a grid of two states for M inputs.
        h: (2,) half the distance of neighbouring grid points.
    """
    slopes = [np.abs(np.diff(d, axis=j)).max(axis=(0, 1, 2)) / (2.0 * h[j]) for j in range(2)]
    return Measured(np.abs(d).max(axis=(0, 1, 2)), np.hypot(*slopes))


def lowest(form: Form, domain: GapDomain) -> float:
    """Infimum of a printed function over X x U, to 1e-7."""
    return -supremum(negated(form), domain.input_set)[1]


def highest(form: Form, domain: GapDomain) -> float:
    """Supremum over X x U, to 1e-7."""
    return supremum(form, domain.input_set)[1]


def allowed(problem: SynthesisProblem, threads: int = 1) -> Allowed:
    """Run synthesis and count; an empty domain is a result here, not an error."""
    try:
        solution = synthesise(problem, threads)
        reason = ""
    except UserError as error:
        solution, reason = None, str(error)
    if solution is None:
        solution = problem.specification.solve(problem.game(threads))
    target = int(solution.target.sum()) if solution.target is not None else 0
    return Allowed(int(solution.winning.sum()), target, int(solution.free.sum()), reason)


def slope_bound(form: Form, domain: GapDomain, part: Box) -> float:
    """Euclidean Lipschitz constant of a printed function over a part of X, by the corners of its gradient's range."""
    smaller = make_form(form.basis, part, domain.input_set, form.coefficients)
    return float(np.linalg.norm(smaller.gradient_bound))


def pendulum_rows(
    domain: GapDomain, printed: Mapping[str, Any], constants: Mapping[str, float], safe: Box, tau: float,
    measured: Measured,
) -> list[Row]:  # fmt: skip
    """The pendulum's table.

    Args:
        domain: X and U of the paper.
        printed: `pendulum` of configs/paper/printed.yaml.
        constants: of the plant: g, l; safe: the safe set, (x1, x2); tau: sampling time, s.
        measured: in PyBullet with default flags.
    """
    gamma, q = (printed_gap(domain, printed[key]).upper for key in ("gamma", "q"))
    eta, one, two = (printed[key] for key in ("eta", "L1", "L2"))
    stated, fitting = float(printed["eps"]), float(printed["eps_of_the_constants"])
    rows = []
    for i, s in enumerate(domain.states):
        pad = float(one[s]) + float(two[s])
        constant = _constant(q[i])
        rows += [
            Row(f"eta_{i + 1}", float(eta[s]), float(measured.largest[i]), "largest |d| in PyBullet, default flags"),
            Row(f"L1^({i + 1})", float(one[s]), float(measured.lipschitz[i]), "of the measured gap"),
            Row(
                f"L2^({i + 1})",
                float(two[s]),
                slope_bound(q[i], domain, safe),
                "analytic, of q.p on the safe set",
            ),
            Row(
                f"constant of gamma_{i + 1}",
                _constant(gamma[i]),
                constant + pad * stated,
                f"eps = {stated:g} as stated",
            ),
            Row(f"constant of gamma_{i + 1}", _constant(gamma[i]), constant + pad * fitting, f"eps = {fitting:g}"),
            Row(f"least q_{i + 1}.p on X", None, lowest(q[i], domain), "must cover |d|, so must not be negative"),
            Row(f"least gamma_{i + 1} on X", None, lowest(gamma[i], domain), "must not be negative"),
        ]
        top = highest(gamma[i], domain)
        rows += [Row(f"sup gamma_{i + 1}, eps = {e['eps']}", e[s], top, "printed formula") for e in printed["suprema"]]
    rows.append(
        Row("L1^(1), theory", float(one["x1"]), 1.5 * tau**2 * constants["g"] / constants["l"], "tau^2 3 g / (2 l)")
    )
    rows.append(
        Row(
            "largest gamma_1 any invariant set allows", highest(gamma[0], domain), tau * float(domain.box.hi[1]),
            "at the smallest x1 of the set tau x2 >= gamma_1 must hold; beside it the printed supremum",
        )
    )  # fmt: skip
    return rows


def turtlebot_rows(domain: GapDomain, printed: Mapping[str, Any], tau: float) -> list[Row]:
    """The robot's table: the printed gap against the longest step."""
    gamma = printed_gap(domain, printed["gamma"]).upper
    fastest = np.abs(domain.input_set).max(axis=0)
    steps = (fastest[0] * tau, fastest[0] * tau, fastest[1] * tau)
    return [
        Row(f"least gamma_{i + 1}", lowest(gamma[i], domain), float(steps[i]), "beside it the longest nominal step")
        for i in range(3)
    ]


def _constant(form: Form) -> float:
    return float(sum(c for c, t in zip(form.coefficients, form.basis.terms, strict=True) if t == "1"))


def table(content: Mapping[str, Any]) -> str:
    """Lines of text: what the printed bounds allow, and printed beside reproduced numbers."""
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


def posed(context: Context, domain: GapDomain, gamma: dict[str, str]) -> SynthesisProblem:
    """The synthesis problem with the printed bound."""
    section = context.need(context.case.synthesis, "synthesis")
    return SynthesisProblem(
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
