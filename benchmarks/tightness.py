"""How tight each way of bounding the gap is, on the pendulum: `python benchmarks/tightness.py [--eps 0.0022]`.

For PyBullet with the declared inertia and with its default one, every objective, sidedness and padding is fitted to the
same samples; the table shows the largest and mean size of the bound, its mean width, the time of the fit, and the
winning fraction of the safe set at the cells of the case. Other bases and bounds follow.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from simgap.config.case import Case
from simgap.dynamics.cases import nominal_model
from simgap.errors import SimgapError, UserError
from simgap.gap.fit import GapResult, fit_gap
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.gap.tiers import check_fresh
from simgap.geometry import Floats, Grid
from simgap.simulators.process import run_in_processes
from simgap.stages.context import Context
from simgap.stages.fresh import draw
from simgap.stages.rollouts import product, roll_out
from simgap.stages.synthesis import pose
from simgap.synthesis.synthesise import synthesise

CASE = Path(__file__).parents[1] / "configs" / "cases" / "pendulum.yaml"
CUBIC = ("x1^3", "x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
DAMPED = ("x2^5", "x2^3", "x1^3", "x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")


def variants(terms: tuple[str, ...]) -> dict[str, GapSettings]:
    """What is compared, by name; the last word of the names of the first twelve is the padding."""
    base = GapSettings("expressions", {"terms": terms}, extreme_value=False)
    found = {}
    for sides in ("unsigned", "signed"):
        for objective in ("eta", "lexicographic"):
            for padding in ("paper", "per_axis", "inflate"):
                name = f"{sides}, {objective}, {padding}"
                found[name] = replace(base, sides=sides, objective=objective, padding=padding)
    found["unsigned constant"] = replace(base, sides="unsigned", bound="constant")
    found["signed constant"] = replace(base, bound="constant")
    found["signed with x1^3"] = replace(base, basis_options={"terms": CUBIC})
    found["signed with x1^3, x2^3, x2^5"] = replace(base, basis_options={"terms": DAMPED})
    found["blocks 16 x 16 x inputs"] = replace(base, basis="blocks", basis_options={"blocks": (16, 16)})
    found["envelope"] = replace(base, bound="envelope")
    return found


def gap_of(context: Context, case: Case, x: Floats, u: Floats) -> Floats:
    """Signed gap of pairs (n, nx), (n, nu) under the simulator section of `case`."""
    parts = zip(np.array_split(x, 2), np.array_split(u, 2), strict=True)
    results = run_in_processes(roll_out, [(case, context.folder, a, b) for a, b in parts], 2)
    return np.concatenate([r[0] for r in results]) - nominal_model(case, context.folder).step(x, u)


def winning(context: Context, result: GapResult | None) -> float:
    """Winning fraction of the safe set under f with the bound, or under f alone."""
    problem, _ = pose(context, None)
    if result is not None:
        problem = replace(problem, gap=result.function.kernel(), gap_axes=None)
    try:
        return synthesise(problem, 2).fraction
    except UserError:  # no controller: the reason is the bound itself
        return 0.0


def measure(context: Context, samples: GapSamples, fresh: tuple[Floats, Floats, Floats], settings: GapSettings) -> dict:
    """One row of the table."""
    began = time.perf_counter()
    result = fit_gap(samples, settings)
    row = {"fit_s": time.perf_counter() - began, "winning": winning(context, result)}
    row["violations"] = check_fresh(result.function, *fresh).violations
    for dim in result.dimensions:
        row[dim.state] = {
            "largest_sample": dim.largest_gap, "sup": dim.sup.size, "ratio": dim.ratio, "mean": dim.mean_size,
            "sup_width": dim.sup.width, "mean_width": dim.mean_width,
        }  # fmt: skip
    return row


def main() -> None:
    """Roll out, fit, synthesise, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--eps", type=float, default=0.0022)
    arguments.add_argument("--fresh", type=int, default=100_000)
    given = arguments.parse_args()
    context = Context.load(CASE)
    grid, inputs = Grid.covering(context.box, given.eps), context.input_set
    table: dict[str, object] = {"eps": given.eps, "nominal": winning(context, None)}
    print(f"nominal alone wins {table['nominal']:.3f}")
    for name, inertia in (("declared inertia", "file"), ("default inertia", "engine")):
        simulator = context.case.simulator.model_copy(update={"inertia": inertia})
        case = context.case.model_copy(update={"simulator": simulator})
        d = gap_of(context, case, *product(grid.centres(), inputs)).reshape(grid.size, len(inputs), -1)
        samples = GapSamples(grid, inputs, d, tuple(context.states), tuple(context.inputs))
        x, u = draw(context.box, inputs, given.fresh, 7)
        fresh = x, u, gap_of(context, case, x, u)
        print(f"\n{name}: {samples.d[:, :, 0].size:,} samples, largest gap {np.abs(d).max(axis=(0, 1))}")
        head = f"{'':36}{'sup 1':>10}{'sup 2':>10}{'mean width 1':>14}{'mean width 2':>14}"
        print(f"{head}{'winning':>9}{'outside':>9}{'s':>6}")
        terms = context.case.gap.basis
        table[name] = rows = {}
        for kind, settings in variants(terms).items():
            try:
                rows[kind] = row = measure(context, samples, fresh, settings)
            except SimgapError as error:
                print(f"{kind:36}{error}")
                continue
            a, b = (row[s] for s in samples.states)
            sizes = f"{a['sup']:>10.3g}{b['sup']:>10.3g}{a['mean_width']:>14.3g}{b['mean_width']:>14.3g}"
            print(f"{kind:36}{sizes}{row['winning']:>9.3f}{row['violations']:>9}{row['fit_s']:>6.1f}", flush=True)
    out = Path(__file__).parent / "results" / "tightness_pendulum.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
