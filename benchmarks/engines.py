"""The gap between simulators, on the pendulum: `python benchmarks/engines.py [--eps 0.0056] [--workers 1]`.

A bound of `a - b` needs no more than both successors on the same grid and inputs, so b may be the nominal model or
another engine. Each pair is bounded as a case does it (signed, inflated) and checked on fresh samples. The last rows
are controls: engines without damping against the semi-implicit Euler step, which is what both of them compute.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.gap import LipschitzSection
from simgap.config.simulator import Damping
from simgap.gap.fitting.acceptance import check_fresh
from simgap.gap.sampling.points import draw, product
from simgap.geometry import Grid
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.simulators.mujoco import MuJoCoSettings
from simgap.simulators.process import run_in_processes
from simgap.simulators.pybullet import PyBulletSettings
from simgap.simulators.rollouts import roll_out

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.gap.fit_in_memory import GapSamples, fit_gap  # noqa: E402

CASE = ROOT / "configs" / "cases" / "pendulum.yaml"
FREE = Damping(linear=0.0, angular=0.0)
ENGINES = {
    "MuJoCo": MuJoCoSettings(),
    "PyBullet, declared inertia": PyBulletSettings(inertia="file"),
    "PyBullet, default inertia": PyBulletSettings(inertia="engine"),
    "PyBullet, declared inertia, no damping": PyBulletSettings(inertia="file", damping=FREE),
}
MODELS = {"explicit Euler": "explicit_euler", "semi-implicit Euler": "semi_implicit_euler"}
PAIRS = (
    ("MuJoCo", "explicit Euler"),
    ("PyBullet, declared inertia", "explicit Euler"),
    ("PyBullet, default inertia", "explicit Euler"),
    ("PyBullet, declared inertia", "MuJoCo"),
    ("PyBullet, default inertia", "MuJoCo"),
    ("PyBullet, declared inertia, no damping", "MuJoCo"),
    ("MuJoCo", "semi-implicit Euler"),
    ("PyBullet, declared inertia, no damping", "semi-implicit Euler"),
)


def successors(context: Context, name: str, x: Floats, u: Floats, workers: int) -> Floats:
    """(n, nx), (n, nu) -> (n, nx) of an engine or a model."""
    case: Case = context.case
    if name in MODELS:
        plant = case.plant.model_copy(update={"integrator": MODELS[name]})
        return PlantModel.of(case.model_copy(update={"plant": plant}), context.folder).sampled.step(x, u)
    other = case.model_copy(update={"simulator": ENGINES[name]})
    parts = zip(np.array_split(x, workers), np.array_split(u, workers), strict=True)
    found = run_in_processes(roll_out, [(other, context.folder, a, b) for a, b in parts], workers)
    return np.concatenate([r[0] for r in found])


def main() -> None:
    """Roll out each engine once, bound each pair, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--eps", type=float, default=0.0056)
    arguments.add_argument("--fresh", type=int, default=100_000)
    arguments.add_argument("--workers", type=int, default=2)
    given = arguments.parse_args()
    context = Context.load(CASE)
    grid, inputs = Grid.covering(context.box, given.eps), context.input_set
    pairs = product(grid.centres(), inputs)
    x, u = draw(context.box, inputs, given.fresh, context.case.gap.seed)
    settings = context.case.gap.model_copy(update={"lipschitz": LipschitzSection(extreme_value=False)})

    @cache
    def ends(name: str) -> tuple[Floats, Floats]:
        return successors(context, name, *pairs, given.workers), successors(context, name, x, u, given.workers)

    rows: list[dict[str, Any]] = []
    for a, b in PAIRS:
        d, fresh = (one - other for one, other in zip(ends(a), ends(b), strict=True))
        shape = grid.size, len(inputs), len(context.states)
        samples = GapSamples(grid, inputs, d.reshape(shape), tuple(context.states), tuple(context.inputs))
        result = fit_gap(samples, settings)
        row: dict[str, Any] = {"of": a, "against": b}
        row["violations"] = check_fresh(result.function, x, u, fresh).violations
        for dim in result.dimensions:
            row[dim.state] = {"largest": dim.largest_sampled_gap, "sup": dim.sup_size, "sup_width": dim.sup_width}
        rows.append(row)
        sizes = "".join(f"{row[s]['largest']:>11.3g}{row[s]['sup_width']:>11.3g}" for s in context.states)
        print(f"{a + ' - ' + b:64}{sizes}{row['violations']:>6}", flush=True)
    out = Path(__file__).parent / "results" / "engines.json"
    out.write_text(json.dumps({"eps": given.eps, "fresh_samples": given.fresh, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
