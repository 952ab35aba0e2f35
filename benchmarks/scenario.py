"""Scenario program at a million samples: time, memory, equality with the full program: `python benchmarks/scenario.py`.

The samples are the pendulum's: PyBullet's default inertia against explicit Euler, on the grid of the case. The full
program hands all rows of a subset to Clarabel at once; 250,000 rows take a minute.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.linear import Basis
from simgap.gap.fitting.scenario import Design, ScenarioResult, solve_scenario
from simgap.geometry import Box, Grid

PAPER = ("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
X = Box([-0.2, -0.5], [0.2, 0.5])
U = np.linspace(-1.2, 1.2, 25)[:, None]


def gap(x: Floats, u: Floats) -> Floats:
    """The velocity gap (N, M): rod with 3/4 of the declared inertia and the engine's default damping, in closed form.

    It agrees with roll-outs to about 1 %; the program does not care, and the benchmark needs no engine.
    """
    tau, angle, speed = 0.005, x[:, :1], x[:, 1:]
    torque = u.T - 0.5 * 9.81 * np.sin(angle)
    return tau * (torque / 0.25 - torque / (1.0 / 3.0)) - 6e-4 * speed - 3e-4 * speed * np.abs(speed)


def timed(design: Design, target: Floats) -> tuple[ScenarioResult, float, float]:
    """Result, seconds on the wall and seconds of processor time of one program."""
    began, worked = time.perf_counter(), time.process_time()
    result = solve_scenario(design, target)
    return result, time.perf_counter() - began, time.process_time() - worked


def full(design: Design, target: Floats) -> tuple[float, float]:
    """Optimum of `min eta` with all rows in one program, and its seconds."""
    import cvxpy as cp

    began = time.perf_counter()
    level = float(np.abs(target).max())
    p = design.rows(np.arange(design.size))
    scale = np.abs(p).max(axis=0)
    q, eta = cp.Variable(p.shape[1]), cp.Variable()
    values = (p / scale) @ q
    problem = cp.Problem(cp.Minimize(eta), [values <= eta, values >= target.ravel() / level])
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return float(eta.value) * level, time.perf_counter() - began


def memory() -> float:
    """Peak resident memory in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> None:
    """Run, print, write the numbers."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--eps", type=float, default=0.0022, help="1,038,450 samples at 0.0022")
    arguments.add_argument("--full", type=int, default=250_000, help="rows of the full program, 0 for none")
    given = arguments.parse_args()
    began = time.perf_counter()
    import cvxpy  # noqa: F401 - its import is timed apart

    record: dict[str, object] = {"import_s": time.perf_counter() - began, "base_memory_gib": memory()}
    basis, x = Basis(PAPER, ("x1", "x2"), ("u",)), Grid.covering(X, given.eps).centres()
    head = f"{'program':10}{'samples':>10}{'seconds':>9}{'cpu s':>7}{'rounds':>8}{'rows':>6}"
    print(f"{head}{'optimum':>14}{'violation':>11}")
    for name, target in (("unsigned", np.abs(gap(x, U))), ("upper", gap(x, U)), ("lower", -gap(x, U))):
        result, seconds, worked = timed(Design.of(basis, x, U), target)
        numbers = f"{result.samples:>10,}{seconds:>9.2f}{worked:>7.2f}{result.rounds:>8}{result.working_set:>6}"
        print(f"{name:10}{numbers}{result.optimum:>14.8g}{result.worst_violation:>11.2g}")
        record[name] = {"seconds": seconds, "cpu_s": worked, **result.to_json()}
    record["peak_memory_gib"] = memory()
    libraries = f"libraries {record['base_memory_gib']:.2f} GiB, cvxpy import {record['import_s']:.1f} s"
    print(f"peak memory {memory():.2f} GiB; {libraries}")
    if given.full:
        record["against_full"] = compare(basis, x, given.full)
    out = Path(__file__).parent / "results" / "scenario.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(record, indent=1) + "\n")


def compare(basis: Basis, x: Floats, rows: int) -> dict[str, float]:
    """Both ways on evenly spread states, about `rows` rows."""
    part = x[:: max(1, len(x) * len(U) // rows)]
    target = np.abs(gap(part, U))
    design = Design.of(basis, part, U)
    result, fast, _ = timed(design, target)
    optimum, slow = full(design, target)
    apart = abs(result.optimum - optimum) / float(np.abs(target).max())
    print(f"{design.size:,} rows: full program {slow:.1f} s, constraint generation {fast:.2f} s")
    print(f"the optima differ by {apart:.1e} of the largest gap")
    return {"rows": design.size, "full_s": slow, "generation_s": fast, "relative_difference": apart}


if __name__ == "__main__":
    main()
