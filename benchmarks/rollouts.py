"""Roll-outs of the pendulum against a bare PyBullet loop of the same calls, in turns, on one core.

python benchmarks/rollouts.py [--count 100000] [--rounds 5]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet as p

from simgap.config.load import load_case
from simgap.simulators.rollouts import make_simulator

ROOT = Path(__file__).parents[1]


def bare(x: np.ndarray, u: np.ndarray, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds for reset, torque, step and read of each pair, written as plainly as can be."""
    client = p.connect(p.DIRECT)
    p.setGravity(0, 0, -9.81)
    p.setTimeStep(0.005)
    body = p.loadURDF(str(ROOT / "configs/models/pendulum.urdf"), useFixedBase=True)
    p.setJointMotorControl2(body, 0, p.VELOCITY_CONTROL, force=0)
    out = np.empty_like(x)
    began = clock()
    for k in range(len(x)):
        p.resetJointState(body, 0, x[k, 0], x[k, 1])
        p.setJointMotorControl2(body, 0, p.TORQUE_CONTROL, force=u[k, 0])
        p.stepSimulation()
        out[k] = p.getJointState(body, 0)[:2]
    seconds = clock() - began
    p.disconnect(client)
    return seconds


def main() -> None:
    """Print and write the rates and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    x = rng.uniform([-0.2, -0.5], [0.2, 0.5], (arguments.count, 2))
    u = rng.uniform(-1.2, 1.2, (arguments.count, 1))
    ours, plain = [], []
    simulator = make_simulator(load_case(ROOT / "configs/cases/pendulum.yaml"), ROOT / "configs/cases")
    for _ in range(arguments.rounds):
        began = time.perf_counter()
        simulator.rollouts(x, u)
        ours.append(time.perf_counter() - began)
        plain.append(bare(x, u))
    result = {
        "rollouts": arguments.count,
        "rate_per_core_1/s": round(arguments.count / min(ours)),
        "bare_rate_per_core_1/s": round(arguments.count / min(plain)),
        "ratio": round(min(plain) / min(ours), 3),
    }
    folder = ROOT / "benchmarks/results"
    folder.mkdir(exist_ok=True)
    (folder / "rollouts.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
