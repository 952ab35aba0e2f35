"""How tight each way of bounding the robot's gap is: `python benchmarks/tightness_turtlebot.py [--workers 1]`.

The robot's bound is a table over U, seen from the robot, over what earlier inputs leave behind. So some combinations of
the pendulum's table do not exist here: between samples nothing is padded (U is finite, the position does not matter,
the heading is rotated exactly), and in place of a padding stands the margin for histories beyond the sampled ones. A
value for each input is the least in sup and in mean at once, so the objective matters only where the table is replaced
by a scenario program in a basis over U. Read are the roll-outs and the bound of a plain run
(`snakemake --cores 2 results/turtlebot/gap/hidden-state/gap.json`).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import SimgapError
from simgap.gap.bounds.body_frame import BodyFrameGap, nominal_motion
from simgap.gap.bounds.linear import Basis
from simgap.gap.bounds.load import from_json
from simgap.gap.fitting.acceptance import check_fresh
from simgap.gap.fitting.scenario import Design, solve_scenario
from simgap.gap.memory.hidden_state import hull
from simgap.gap.sampling.points import AFTER_PREVIOUS, body_samples
from simgap.gap.sampling.samples import steps_of
from simgap.io.results import read_json
from simgap.plants.context import Context, pose_axes
from simgap.stages.gap_inputs import read_samples
from simgap.stages.synthesis import pose_problem
from simgap.synthesis.synthesise import SynthesisProblem, synthesise

ROOT = Path(__file__).parents[1]
CASE = ROOT / "configs" / "cases" / "turtlebot.yaml"
SHARDS = 2
DEFAULT = "signed, value per input, margin"
Sides = tuple[Floats, Floats]


def results() -> dict[str, Path]:
    """What the stages of a plain run wrote."""
    folder = ROOT / "results" / "turtlebot"
    names = {"fresh": "fresh/samples.parquet", "gap": "gap/hidden-state/gap.json"}
    names |= {f"shard {k}": f"rollouts/hidden-state/shard-{k}.parquet" for k in range(SHARDS)}
    found = {key: folder / name for key, name in names.items()}
    missing = [str(path) for path in found.values() if not path.is_file()]
    if missing:
        raise SystemExit(f"{missing} are missing; run: snakemake --cores 2 results/turtlebot/{names['gap']}")
    return found


def program(context: Context, objective: str) -> Callable[[Floats], Floats]:
    """The least q.p(u) above targets (M,), as the pendulum's sides are fitted."""
    v, w = context.inputs
    basis = Basis((f"{v}^2", f"{w}^2", f"{v}*{w}", v, w, "1"), tuple(context.states), tuple(context.inputs))
    design = Design.of(basis, np.zeros((1, len(context.states))), context.input_set)

    def above(target: Floats) -> Floats:
        found = solve_scenario(design, target[None], objective)
        return design.product(found.coefficients).whole()[0] + found.worst_violation

    return above


def shapes(context: Context) -> dict[str, Callable[[Floats], Floats]]:
    """How one side (M,) of one state is carried over U."""
    return {
        "constant": lambda target: np.full_like(target, target.max()),
        "eta program": program(context, "eta"),
        "lexicographic program": program(context, "lexicographic"),
        "value per input": lambda target: target,
    }


def variants(context: Context, default: Sides, bare: Sides, rest: Sides) -> dict[str, Sides]:
    """Body-frame tables (lower, upper), each (M, 3), by name; the last word says what stands beside the samples."""
    found = {}
    for sides in ("unsigned", "signed"):
        for name, above in shapes(context).items():
            lower, upper = (-above_all(above, -default[0]), above_all(above, default[1]))
            if sides == "unsigned":
                upper = above_all(above, np.maximum(-default[0], default[1]))
                lower = -upper
            found[f"{sides}, {name}, margin"] = lower, upper
    found["signed, value per input, no margin"] = bare
    found["signed, value per input, from rest alone"] = rest
    return found


def above_all(above: Callable[[Floats], Floats], targets: Floats) -> Floats:
    """Column by column."""
    return np.stack([above(np.ascontiguousarray(column)) for column in targets.T], axis=1)


def row_of(
    context: Context, problem: SynthesisProblem, gap: BodyFrameGap, largest: Floats, drawn: Sides, workers: int
) -> Any:
    """One row of the table."""
    x = np.tile(0.5 * (context.box.lo + context.box.hi), (len(drawn[0]), 1))
    x[:, gap.pose[2]] = 0.0  # there the robot's frame is the world's
    size, width = np.maximum(np.abs(gap.lower), np.abs(gap.upper)), gap.upper - gap.lower
    row: dict[str, Any] = {"violations": check_fresh(gap, x, drawn[0], drawn[1]).violations}
    began = time.process_time()
    try:
        row["winning"] = synthesise(replace(problem, gap=gap.kernel()), workers).fraction
    except SimgapError as error:
        row |= {"winning": 0.0, "refused": str(error)}
    row["synthesis_cpu_s"] = round(time.process_time() - began, 1)
    for i, state in enumerate(context.states):
        row[state] = {
            "sup": float(size[:, i].max()), "ratio": float(size[:, i].max() / largest[i]),
            "mean": float(size[:, i].mean()), "mean_width": float(width[:, i].mean()),
        }  # fmt: skip
    return row


def main() -> None:
    """Roll out, bound, synthesise, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--workers", type=int, default=2)
    workers = arguments.parse_args().workers
    context = Context.load(CASE)
    path = results()
    content = read_json(path["gap"])
    default = from_json(content)
    with_classes, _ = pose_problem(context, path["gap"])
    problem = replace(with_classes, previous=None)  # one bound after any previous input; the classes have a line below
    model, axes, inputs = context.plant.sampled, pose_axes(context), context.input_set
    centre = 0.5 * (context.box.lo + context.box.hi)
    motion = nominal_motion(model.step, centre, inputs, axes, np.random.default_rng(0))
    shards = [read_samples(context, path[f"shard {k}"], "rollouts") for k in range(SHARDS)]
    grid = steps_of(context, shards, AFTER_PREVIOUS)
    d = grid.final - motion[grid.m]
    bare = hull(grid.m, d, len(inputs))
    still = d[grid.previous == np.abs(inputs).sum(axis=1).argmin()]
    fresh_steps = body_samples(context.case, read_samples(context, path["fresh"], "fresh"))
    drawn = inputs[fresh_steps.m], fresh_steps.final - motion[fresh_steps.m]
    largest = np.abs(d).max(axis=0)
    rows: dict[str, Any] = {}
    print(f"{len(d):,} roll-outs, {len(drawn[0]):,} fresh steps, largest gap {largest}", flush=True)
    for name, (lower, upper) in variants(context, (default.lower, default.upper), bare, (still, still)).items():
        gap = BodyFrameGap(default.domain, (), lower[None], upper[None], default.pose)
        rows[name] = row = row_of(context, problem, gap, largest, drawn, workers)
        sizes = "".join(f"{row[s]['sup']:>10.3g}{row[s]['mean_width']:>10.3g}" for s in context.states)
        print(f"{name:44}{sizes}{row['winning']:>9.4f}{row['violations']:>7}", flush=True)
    began = time.process_time()
    won = synthesise(with_classes, workers).fraction
    print(f"after each of {default.classes.count} classes of the previous input {won:.4f}, "
          f"{time.process_time() - began:.1f} CPU s")  # fmt: skip
    own = {k: v for k, v in rows.items() if k.endswith(", margin")}
    best = all(rows[DEFAULT]["winning"] >= r["winning"] for r in own.values()) and all(
        rows[DEFAULT][s]["mean_width"] <= r[s]["mean_width"] for r in own.values() for s in context.states
    )
    table = {"roll_outs": len(d), "fresh_steps": len(drawn[0]), "states": context.states,
             "with_classes": won, "default": DEFAULT, "default_is_tightest": best, "rows": rows}  # fmt: skip
    (ROOT / "benchmarks" / "results" / "tightness_turtlebot.json").write_text(json.dumps(table, indent=1) + "\n")
    print(f"the default is {'' if best else 'NOT '}the tightest of those with a margin")


if __name__ == "__main__":
    main()
