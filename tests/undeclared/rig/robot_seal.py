"""Recordings of the robot as a person would hand them over, and what the rig was told in a file that scoring opens."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from tests.undeclared.rig import robot

DRAWS = {
    "speed gain": ("speed_gain", (0.85, 0.95), ("input_gain", "v", "ratio")),
    "turn gain": ("turn_gain", (1.06, 1.15), ("input_gain", "w", "ratio")),
    "speed bias": ("speed_bias", (0.01, 0.03), ("input_bias", "v", "bias")),
    "turn bias": ("turn_bias", (0.02, 0.05), ("input_bias", "w", "bias")),
    "wheels": ("right_wheel", (1.03, 1.06), ("wheel_mismatch", "plant", "ratio")),
    "slip": ("slip", (0.04, 0.08), ("lateral_slip", "plant", "ratio")),
    "heading offset": ("heading_offset", (0.05, 0.1), ("sensor_offset", "theta", "offset")),
    "late turning": ("turn_delay", (0.04, 0.12), ("input_delay", "w", "delay")),
    "slow turning": ("turn_lag", (0.15, 0.4), ("input_lag", "w", "T")),
    "rolling": ("rolling", (0.01, 0.03), ("rolling_resistance", "plant", "loss")),
    "leaking wheel": ("leak", (0.004, 0.008), None),
}


def produce(folder: Path, kind: str, seed: int, heading: bool = True, seconds: float = 30.0) -> list[Path]:
    """Write `run0.csv`, `run1.csv` (heading wrapped into half a turn either way) and `sealed.json`."""
    rng = np.random.default_rng([seed, *kind.encode()])
    hidden, sealed = {}, {"effects": [], "parameters": {}}
    if kind in DRAWS:
        key, (low, high), effect = DRAWS[kind]
        hidden[key] = float(rng.uniform(low, high))
        if key.endswith("delay"):  # what is sealed is what acts: whole steps of the rig
            hidden[key] = round(hidden[key] / robot.STEP) * robot.STEP
        if effect is not None:
            name, on, symbol = effect
            sealed = {"effects": [[name, on]], "parameters": {f"{name} {on}": {symbol: hidden[key]}}}
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for k, (t, poses, commands) in enumerate(robot.record(hidden, rng, heading, seconds)):
        names = ["t", "x", "y", *(["theta"] if heading else []), "v", "w"]
        if heading:
            poses = np.column_stack([poses[:, :2], np.angle(np.exp(1j * poses[:, 2]))])
        paths.append(folder / f"run{k}.csv")
        with paths[-1].open("w", newline="") as out:
            writer = csv.writer(out)
            writer.writerow(names)
            writer.writerows([f"{cell:.6f}" for cell in row] for row in np.column_stack([t, poses, commands]))
    (folder / "sealed.json").write_text(json.dumps(sealed))
    return paths
