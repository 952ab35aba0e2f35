"""How tight each way of bounding the gap is, on the pendulum: `python benchmarks/tightness.py [--workers 1]`.

For PyBullet with the declared inertia and with its default one, every objective, sidedness and padding is fitted to the
same samples, at the case's own eps; the table shows the largest and mean size of the bound, its mean width, the time of
the fit, fresh samples outside, and the winning fraction of the safe set at the cells of the case. Other bases and
bounds follow. At the end the figures that the bounds have to reach are held against their goals. Written are
results/tightness_pendulum.json and results/figures_gap.json.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.gap import GapSection, LipschitzSection
from simgap.errors import SimgapError, UserError
from simgap.gap.bases import Blocks, Expressions
from simgap.gap.checked_bound import GapResult
from simgap.gap.fitting.acceptance import check_fresh
from simgap.gap.sampling.points import draw, product
from simgap.geometry import Grid
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages.synthesis import pose_problem
from simgap.synthesis.synthesise import synthesise

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.gap.fit_in_memory import GapSamples, fit_gap  # noqa: E402

CASE = ROOT / "configs" / "cases" / "pendulum.yaml"
OUT = Path(__file__).parent / "results"
CUBIC = ("x1^3", "x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
DAMPED = ("x2^5", "x2^3", "x1^3", "x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
DEFAULT, CONSTANT = "signed, lexicographic, inflate", "unsigned constant"
INERTIAS = {"declared inertia": "file", "default inertia": "engine"}


def variants(terms: tuple[str, ...]) -> dict[str, GapSection]:
    """What is compared, by name; the last word of the names of the first twelve is the padding."""
    base = GapSection(basis=Expressions(terms=terms), lipschitz=LipschitzSection(extreme_value=False))
    found = {}
    for sides in ("unsigned", "signed"):
        for objective in ("eta", "lexicographic"):
            for padding in ("paper", "per_axis", "inflate"):
                name = f"{sides}, {objective}, {padding}"
                found[name] = base.model_copy(update={"sides": sides, "objective": objective, "padding": padding})
    constant = {"basis": Expressions(terms=("1",))}
    found["unsigned constant"] = base.model_copy(update={"sides": "unsigned"} | constant)
    found["signed constant"] = base.model_copy(update=constant)
    found["signed with x1^3"] = base.model_copy(update={"basis": Expressions(terms=CUBIC)})
    found["signed with x1^3, x2^3, x2^5"] = base.model_copy(update={"basis": Expressions(terms=DAMPED)})
    found["blocks 16 x 16 x inputs"] = base.model_copy(update={"basis": Blocks(blocks=(16, 16))})
    return found


def gap_of(context: Context, case: Case, x: Floats, u: Floats, workers: int) -> Floats:
    """Signed gap of pairs (n, nx), (n, nu) under the simulator section of `case`."""
    parts = zip(np.array_split(x, workers), np.array_split(u, workers), strict=True)
    results = run_in_processes(roll_out, [(case, context.folder, a, b) for a, b in parts], workers)
    return np.concatenate([r[0] for r in results]) - context.plant.sampled.step(x, u)


def winning(context: Context, result: GapResult | None, workers: int) -> float:
    """Winning fraction of the safe set under f with the bound, or under f alone."""
    problem, _ = pose_problem(context, None)
    if result is not None:
        problem = replace(problem, gap=result.function.kernel(), gap_axes=None)
    try:
        return synthesise(problem, workers).fraction
    except UserError:  # no controller: the reason is the bound itself
        return 0.0


def cpu_seconds() -> float:
    """Processor time of this process and of those it has waited for."""
    parts = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(p.ru_utime + p.ru_stime for p in parts)


def row_of(
    context: Context, samples: GapSamples, fresh: tuple[Floats, Floats, Floats], settings: GapSection, workers: int
) -> dict[str, Any]:
    """One row of the table."""
    began = time.process_time()
    result = fit_gap(samples, settings)
    row: dict[str, Any] = {"fit_cpu_s": round(time.process_time() - began, 2)}
    began = time.process_time()
    row["violations"] = check_fresh(result.function, *fresh).violations
    row |= {"check_cpu_s": round(time.process_time() - began, 2), "winning": winning(context, result, workers)}
    for dim in result.dimensions:
        row[dim.state] = {
            "largest_sample": dim.largest_sampled_gap, "sup": dim.sup_size, "ratio": dim.sup_over_largest_sample,
            "mean": dim.mean_size, "sup_width": dim.sup_width, "mean_width": dim.mean_width,
        }  # fmt: skip
    return row


def rows_of(context: Context, inertia: str, eps: float, workers: int) -> dict[str, Any]:
    """All rows of one simulator, and what the roll-outs of the fresh samples cost."""
    grid, inputs = Grid.covering(context.box, eps), context.input_set
    simulator = context.case.simulator.model_copy(update={"inertia": inertia})
    case = context.case.model_copy(update={"simulator": simulator})
    d = gap_of(context, case, *product(grid.centres(), inputs), workers).reshape(grid.size, len(inputs), -1)
    samples = GapSamples(grid, inputs, d, tuple(context.states), tuple(context.inputs))
    x, u = draw(context.box, inputs, context.case.gap.fresh_samples, context.case.gap.seed)
    began = cpu_seconds()
    fresh = x, u, gap_of(context, case, x, u, workers)
    spent = cpu_seconds() - began
    print(f"{samples.d[:, :, 0].size:,} samples, largest gap {np.abs(d).max(axis=(0, 1))}", flush=True)
    rows: dict[str, Any] = {}
    for kind, settings in variants(context.case.gap.basis.terms).items():
        try:
            rows[kind] = row = row_of(context, samples, fresh, settings, workers)
        except SimgapError as error:
            print(f"{kind:36}{error}", flush=True)
            continue
        sizes = "".join(f"{row[s]['sup']:>10.3g}{row[s]['mean_width']:>12.3g}" for s in samples.states)
        print(f"{kind:36}{sizes}{row['winning']:>9.4f}{row['violations']:>7}{row['fit_cpu_s']:>7.1f}", flush=True)
    return {"rows": rows, "fresh_samples": len(x), "fresh_cpu_s": round(spent, 1)}


def figures(table: dict[str, Any]) -> list[dict[str, Any]]:
    """What has to be reached, what was, and whether it is enough."""
    matched, default = (table[name]["rows"] for name in INERTIAS)
    tight, states = matched[DEFAULT], ("x1", "x2")
    ratio = default[DEFAULT]["winning"] / default[CONSTANT]["winning"]
    checks = [t["fresh_cpu_s"] + t["rows"][DEFAULT]["check_cpu_s"] for t in (table[name] for name in INERTIAS)]
    outside = matched[DEFAULT]["violations"] + default[DEFAULT]["violations"]
    nominal = f"{table['nominal']:.4f} for the nominal model alone"
    found: list[tuple[str, float, str, float, str]] = [
        (f"declared inertia: sup over largest sample, {s}", tight[s]["ratio"], "<=", 1.05, "") for s in states
    ]
    found.append(("declared inertia: winning", tight["winning"], ">=", 0.92, nominal))
    note = f"{default[DEFAULT]['winning']:.4f} against {default[CONSTANT]['winning']:.4f}"
    found.append(("default inertia: winning, over that of the unsigned constant", ratio, ">=", 2.4, note))
    samples = f"of {2 * table['default inertia']['fresh_samples']:,}"
    found.append(("fresh samples outside, both inertias", outside, "<=", 0, samples))
    found.append(("check on fresh samples, CPU seconds, the longer", max(checks), "<=", 30, "roll-outs included"))
    best = [name for name, rows in (("declared", matched), ("default", default)) if not best_is_default(rows)]
    found.append(("inertias where another combination is tighter", len(best), "<=", 0, ", ".join(best)))
    return [
        {"figure": name, "value": value, "goal": f"{sign} {goal:g}", "note": more,
         "reached": bool(value <= goal if sign == "<=" else value >= goal)}
        for name, value, sign, goal, more in found
    ]  # fmt: skip


def best_is_default(rows: dict[str, Any]) -> bool:
    """Whether no objective, sidedness and padding wins more cells, or has a smaller mean width, than the default."""
    own = rows[DEFAULT]
    others = [row for name, row in rows.items() if name.endswith(("paper", "per_axis", "inflate"))]
    narrow = all(own[s]["mean_width"] <= row[s]["mean_width"] for row in others for s in ("x1", "x2"))
    return narrow and all(own["winning"] >= row["winning"] for row in others)


def main() -> None:
    """Roll out, fit, synthesise, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--eps", type=float, help="the case's own if not given")
    arguments.add_argument("--workers", type=int, default=2)
    given = arguments.parse_args()
    context = Context.load(CASE)
    eps = given.eps or context.case.grid.eps
    table: dict[str, Any] = {"eps": eps, "nominal": winning(context, None, given.workers)}
    print(f"nominal alone wins {table['nominal']:.4f}", flush=True)
    OUT.mkdir(exist_ok=True)
    for name, inertia in INERTIAS.items():
        print(f"\n{name}", flush=True)
        table[name] = rows_of(context, inertia, eps, given.workers)
        (OUT / "tightness_pendulum.json").write_text(json.dumps(table, indent=1) + "\n")
    reached = figures(table)
    (OUT / "figures_gap.json").write_text(json.dumps({"eps": eps, "figures": reached}, indent=1) + "\n")
    for f in reached:
        print(f"{f['figure']:64}{f['value']:>10.4g}  goal {f['goal']:8}{'reached' if f['reached'] else 'MISSED'}")


if __name__ == "__main__":
    main()
