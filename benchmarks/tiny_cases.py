"""Tiny cases that take every stage in seconds: what the benchmarks of faults run."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
PENDULUM = yaml.safe_load((ROOT / "configs/cases/pendulum.yaml").read_text())
SMALL = {
    "name": "small",
    "plant": PENDULUM["plant"] | {"urdf": "pendulum.urdf"},
    "domain": PENDULUM["domain"] | {"U": {"u": {"min": -1.2, "max": 1.2, "step": 0.4}}},
    "simulator": PENDULUM["simulator"],
    "grid": {"eps": 0.02, "shards": 2},
    "gap": PENDULUM["gap"] | {"fresh_samples": 1000, "padding": "per_axis"},
    "synthesis": PENDULUM["synthesis"] | {"cells": [120, 60]},
    "validation": {"starts": 10, "steps": 60, "seed": 1},
    "audit": {"evaluations": 1000, "steps": 500},
    "measured": PENDULUM["measured"],
}
RIG = {"case": "../small.yaml", "substeps": 5, "traces": 2, "seconds": 5, "seed": 3, "noise": {"x1": 0.001},
       "excitation": {"amplitude": 3.0, "low": 0.1, "high": 8.0}}  # fmt: skip
TWIN = {
    "name": "twin",
    "plant": {
        "integrator": "rk4",
        "symbolic": {"parameters": {"m": {"value": 1.0, "unit": "kg"}}, "dynamics": {"x": "v", "v": "F/m"}},
        "states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}},
        "inputs": {"F": {"unit": "N"}},
    },
    "domain": {"tau": 0.1, "X": {"x": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 0, 1]}}},
    "simulator": {"engine": "equations", "integrator": "rk4", "parameters": {"m": 1.05}},
    "twin": {"of": {"engine": "python", "function": "sim.py:step"}, "tolerance": {"x": 1e-12, "v": 1e-12}},
    "grid": {"eps": 0.2, "shards": 1},
    "gap": {"basis": ["x", "v", "F", 1], "fresh_samples": 500},
    "synthesis": {"cells": [60, 60], "specification": {"kind": "reach_and_stay",
                                                       "target": {"x": [-0.4, 0.4], "v": [-0.6, 0.6]}}},
    "validation": {"starts": 10, "steps": 60, "seed": 1},
    "audit": {"evaluations": 500, "steps": 300},
}  # fmt: skip
ENGINE = """import numpy as np


def step(x, u, tau):
    a = u[0] / 1.05
    return np.array([x[0] + tau * x[1] + a * tau * tau / 2, x[1] + tau * a])
"""
TURTLEBOT = yaml.safe_load((ROOT / "configs/cases/turtlebot.yaml").read_text())
ROVER = {
    "name": "rover",
    "plant": TURTLEBOT["plant"],
    "domain": {"tau": 1.0, "X": {"x": [0, 3.4], "y": [0, 3], "theta": [-math.pi, math.pi]}, "periodic": ["theta"],
               "U": {"v": {"min": -0.2, "max": 0.2, "step": 0.1}, "w": {"min": -0.4, "max": 0.4, "step": 0.4}}},
    "simulator": TURTLEBOT["simulator"] | {"urdf": "turtlebot.urdf"},
    "hidden_state": TURTLEBOT["hidden_state"] | {
        "previous": {"v": 3, "w": 2}, "chains": 20, "chain_length": 100, "fresh_samples": 300,
        "classes": {"v": 2, "w": 1}, "search": 150,
    },
    "symmetry": TURTLEBOT["symmetry"] | {"histories": 5, "headings": 2},
    "synthesis": {
        "cells": [68, 60, 32],
        "specification": {"kind": "reach_avoid", "obstacles": [{"x": [1.6, 1.7], "y": [0.0, 1.6]}],
                          "target": {"x": [2.2, 3.0], "y": [0.4, 1.2]}, "clearance": {"x": 0.18, "y": 0.18}},
    },
    "validation": {"starts": 4, "steps": 300, "seed": 1},
    "audit": {"evaluations": 500, "steps": 300},
}  # fmt: skip
NAMES = ("small.yaml", "twin.yaml", "rover.yaml")


def write_cases(folder: Path) -> None:
    """PyBullet with a rig, equations with a twin, and a robot with memory among obstacles."""
    (folder / "rigs").mkdir(parents=True, exist_ok=True)
    for name in ("pendulum", "turtlebot"):
        shutil.copy(ROOT / f"configs/models/{name}.urdf", folder)
    cases = {"small.yaml": SMALL, "rigs/small.yaml": RIG, "twin.yaml": TWIN, "rover.yaml": ROVER}
    for path, content in cases.items():
        (folder / path).write_text(yaml.safe_dump(content, sort_keys=False))
    (folder / "sim.py").write_text(ENGINE)
