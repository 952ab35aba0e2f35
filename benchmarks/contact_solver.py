"""What PyBullet's contact solvers make of a wheeled robot's step: `python benchmarks/contact_solver.py`.

Random histories of three inputs (seed 77, which no test and no case uses) are driven at heading 0, at four random
headings, and mirrored left to right. A row is a solver with its iterations: CPU time of a robot's step, largest
difference between headings and from the mirror image, largest and root mean square difference from the reference
(sequential impulses, 1,000 iterations, no residual threshold), and the share of engine steps that the direct solver
left to sequential impulses.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pybullet as p

from simgap.config.load import load_case
from simgap.simulators.rollouts import make_simulator

ROOT = Path(__file__).parents[1]
SEQUENTIAL, DIRECT = p.CONSTRAINT_SOLVER_LCP_SI, p.CONSTRAINT_SOLVER_LCP_DANTZIG
ROWS: dict[str, dict[str, Any]] = {
    "reference": {"constraintSolverType": SEQUENTIAL, "numSolverIterations": 1000, "solverResidualThreshold": 0.0},
    **{f"sequential, {n} iterations": {"constraintSolverType": SEQUENTIAL, "numSolverIterations": n}
       for n in (30, 50, 75, 100, 200, 400)},
    "direct, no softness, 50 iterations": {"globalCFM": 0.0, "numSolverIterations": 50},
    "direct, no softness, 100 iterations": {"globalCFM": 0.0},
    "direct, softness 1e-10": {"globalCFM": 1e-10},
    "direct, as shipped (softness 1e-8)": {},
    "direct, softness 1e-6": {"globalCFM": 1e-6},
}  # fmt: skip
HEADINGS = 4


def drive(name: str, histories: np.ndarray, headings: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """-> ends (n, 1 + HEADINGS, 3), ends of the mirrored histories mirrored back (n, 3), ms a step, share left over."""
    case = load_case(ROOT / "configs/cases/turtlebot.yaml")
    robot: Any = make_simulator(case, ROOT / "configs/cases")
    robot._p.setPhysicsEngineParameter(**ROWS[name])
    robot._rest = robot._kept()
    began = time.process_time()
    ends = np.array([[robot.chain(np.array([0, 0, t]), h)[1][-1, -1] for t in (0.0, *own)]
                     for h, own in zip(histories, headings, strict=True)])  # fmt: skip
    spent = time.process_time() - began
    image = np.array([robot.chain(np.zeros(3), h * [1, -1])[1][-1, -1] for h in histories]) * [1, -1, -1]
    left = _left_over(robot, histories)
    robot.close()
    return ends, image, 1e3 * spent / ends[..., 0].size / histories.shape[1], left


def _left_over(robot: Any, histories: np.ndarray) -> float:
    """The share of steps at which Bullet tells of iterations: it does so of sequential impulses alone."""
    told = []
    robot._p.setPhysicsEngineParameter(reportSolverAnalytics=1)
    robot.reset(np.zeros(3))
    for u in histories[:10].reshape(-1, 2):
        robot._command(*u)
        for _ in range(robot._section.poses):
            told.append(robot._p.stepSimulation()[0]["remainingResidual"])
    changed = np.diff(told, prepend=-1.0) != 0  # of a step without iterations it repeats what it told last
    return float(changed.mean())


def main() -> None:
    """Print and write the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--histories", type=int, default=40)
    n, rng = parser.parse_args().histories, np.random.default_rng(77)
    case = load_case(ROOT / "configs/cases/turtlebot.yaml")
    values = [np.arange(round(own.min / own.step), round(own.max / own.step) + 1) * own.step
              for own in case.domain.U.values()]  # fmt: skip
    drawn = [np.where(rng.random((n, 3)) < 0.5, rng.choice(v[[0, -1]], (n, 3)), rng.choice(v, (n, 3))) for v in values]
    histories, headings = np.stack(drawn, axis=-1), rng.uniform(-np.pi, np.pi, (n, HEADINGS))
    rows, reference = {}, None
    for name in ROWS:
        ends, image, cost, left = drive(name, histories, headings)
        reference = ends if reference is None else reference
        off = ends - reference
        rows[name] = {
            "ms_a_step": round(cost, 2),
            "left_to_sequential": round(left, 3) if name.startswith("direct") else None,
            "between_headings": np.abs(ends[:, 1:] - ends[:, :1]).max(axis=(0, 1)).tolist(),
            "from_mirror_image": np.abs(image - ends[:, 0]).max(axis=0).tolist(),
            "from_reference": np.abs(off).max(axis=(0, 1)).tolist(),
            "from_reference_rms": np.sqrt((off**2).mean(axis=(0, 1))).tolist(),
        }
        print(name, json.dumps(rows[name]), flush=True)
    out = ROOT / "benchmarks/results/contact_solver.json"
    out.write_text(json.dumps({"histories": n, "headings": HEADINGS, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
