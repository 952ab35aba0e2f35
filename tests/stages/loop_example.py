"""Results of two small cases, made by hand and without any engine: a pendulum to keep safe, a robot to bring home."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import yaml

from simgap.config.gap import GapSection, LipschitzSection
from simgap.config.load import load_case
from simgap.gap.bases import Expressions
from simgap.gap.fitting.acceptance import check_fresh
from simgap.geometry import Box, Grid
from simgap.io.controller_file import save_controller
from simgap.io.results import table, write_json, write_parquet
from simgap.provenance import provenance
from simgap.specifications.solution import Solution
from simgap.synthesis.controller import Controller
from tests.gap.fit_in_memory import GapSamples, fit_gap

ROBOT = """
name: robot
title: A robot among obstacles
plant:
  symbolic:
    dynamics: {x: v*cos(heading), y: v*sin(heading), heading: w}
    wheels: {x: x, y: y, heading: heading, linear: v, angular: w, track: 0.2}
  states: {x: {unit: m}, y: {unit: m}, heading: {unit: rad}}
  inputs: {v: {unit: m/s}, w: {unit: rad/s}}
  integrator: exact_arc
domain:
  tau: 1 s
  X: {x: [0, 4], y: [0, 4], heading: [-3.141592653589793, 3.141592653589793]}
  U: {v: {min: -0.2, max: 0.2, step: 0.1}, w: {min: -0.2, max: 0.2, step: 0.1}}
synthesis:
  cells: [20, 20, 8]
  specification:
    kind: reach_avoid
    obstacles: [{x: [1.5, 2.0], y: [0, 2.5]}]
    target: {x: [3, 4], y: [3, 4]}
    clearance: {x: 0.18, y: 0.18}
"""


def record(folder, stage):
    """What the results of a stage say of the case in the folder."""
    case = folder / "case.yaml"
    return provenance(stage, load_case(case), folder, {"starts": 1})


UNITS = {"pendulum": {"x1": "rad", "x2": "rad/s", "u": "N*m"},
         "robot": {"x": "m", "y": "m", "heading": "rad", "v": "m/s", "w": "rad/s"}}  # fmt: skip


def pendulum(root, folder):
    """Write case and results of the pendulum: -> the case's path."""
    content = yaml.safe_load((root / "configs/cases/pendulum.yaml").read_text())
    content["plant"]["urdf"] = str(root / "configs/models/pendulum.urdf")
    content["grid"]["eps"] = 0.05
    content.pop("measured", None)
    box, inputs = Box([-0.2, -0.5], [0.2, 0.5]), np.round(np.linspace(-1.2, 1.2, 25), 12)[:, None]
    safe = Box([0.0, -0.5], [0.2, 0.5])
    path = _case(folder, content)
    _results(folder, "pendulum", box, inputs, safe, Grid(safe, (20, 10), ()), _pendulum_gap, 0.005, 40)
    return path


def robot(folder):
    """Write case and results of the robot: -> the case's path."""
    content = yaml.safe_load(ROBOT)
    box = Box([0.0, 0.0, -np.pi], [4.0, 4.0, np.pi])
    values = np.round(np.linspace(-0.2, 0.2, 5), 12)
    inputs = np.stack(np.meshgrid(values, values, indexing="ij"), axis=-1).reshape(-1, 2)
    path = _case(folder, content)
    _results(folder, "robot", box, inputs, box, Grid(box, (20, 20, 8), (2,)), _robot_gap, 1.0, 30)
    return path


def arguments(folder):
    """What the report stage reads of a folder of results."""
    return {
        "gaps": [folder / "gap.json"],
        "samples": folder / "samples.parquet",
        "nominal": folder / "nominal/controller.npz",
        "nominal_summary": folder / "nominal/synthesis.json",
        "gap_aware": folder / "gap/controller.npz",
        "gap_aware_summary": folder / "gap/synthesis.json",
        "validation": folder / "validation/validation.json",
        "traces": folder / "validation/traces.parquet",
    }


def _case(folder, content):
    path = folder / "case.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def _pendulum_gap(x, u):
    d2 = -0.02 * x[..., 0] + 0.005 * u[..., 0] - 3e-4 * x[..., 1] ** 3
    return np.stack([0.005 * d2, d2], axis=-1)


def _robot_gap(x, u):
    v, w = u[..., 0], u[..., 1]
    return np.stack([0.01 * v, 0.02 * v * w, 0.05 * w + 0.001], axis=-1)


def _results(folder, case, box, inputs, safe, grid, gap, tau, steps):
    names = list(UNITS[case])
    states, input_names = tuple(names[: box.size]), tuple(names[box.size :])
    _write_gap(folder, box, inputs, states, input_names, gap, UNITS[case])
    tables, tallies = [], {}
    for kind in ("nominal", "gap"):
        made = record(folder, "synthesis")
        controller = _controller(grid, inputs, states, input_names, kind, box, made)
        (folder / kind).mkdir(parents=True)
        save_controller(controller, folder / kind / "controller.npz")
        s = controller.solution
        write_json(folder / kind / "synthesis.json", {
            "model": kind, "cells": list(grid.cells), "inputs": len(inputs),
            "winning_cells": int(s.winning.sum()),
            "free_cells": int(s.free.sum()), "winning_fraction": s.fraction,
            "winning_fraction_after_inflation": 0.98 if case == "robot" else None,
            "statistics": {}, "provenance": made})  # fmt: skip
        tallies[kind] = {}
        for plant in ("simulator", "nominal model"):
            bad = kind == "nominal" and plant == "simulator"
            tables += [
                _trace(folder, case, kind, plant, run, safe, inputs, states, input_names, gap, tau, steps, bad)
                for run in (0, 1)
            ]
            tallies[kind][plant] = {
                "runs": 2, "steps": 2 * steps, "runs_that_kept_the_specification": 0 if bad else 2,
                "runs_that_violated_it": 2 if bad else 0, "ends": {"left the safe set": 2} if bad else {"stayed": 2},
                "steps_outside_gamma": 0, "median_steps_until_violation": 20.0 if bad else None}  # fmt: skip
            if case == "robot" and not bad:
                tallies[kind][plant]["steps_to_target"] = [28, 30]
    write_parquet(folder / "validation/traces.parquet", pa.concat_tables(tables).unify_dictionaries())
    write_json(folder / "validation/validation.json", {
        "starts": 2, "steps": steps, "controllers": tallies, "provenance": record(folder, "validation")})  # fmt: skip


def _write_gap(folder, box, inputs, states, input_names, gap, units):
    grid = Grid.covering(box, 0.05 if box.size == 2 else 0.6)
    x = np.broadcast_to(grid.centres()[:, None, :], (grid.size, len(inputs), box.size))
    d = np.ascontiguousarray(gap(x, inputs[None].repeat(grid.size, 0)))
    terms = ("x1", "x2", "u", "1") if box.size == 2 else ("v", "w", "1")
    samples = GapSamples(grid, inputs, d, states, input_names)
    result = fit_gap(
        samples, GapSection(basis=Expressions(terms=terms), lipschitz=LipschitzSection(extreme_value=False))
    )
    rng = np.random.default_rng(1)
    fresh_x, fresh_u = box.sample(rng, 200), inputs[rng.integers(0, len(inputs), 200)]
    check = check_fresh(result.function, fresh_x, fresh_u, gap(fresh_x, fresh_u))
    function = result.function.with_tiers([*result.function.tiers, check.tier])
    fresh = {"samples": 200, "violations": check.violations, "upper": check.upper, "confidence": check.confidence}
    point = {"eps": 0.05} if box.size == 2 else {}  # a robot's bound over histories has none
    content = result.to_json() | function.to_json() | {**point, "fresh": fresh, "provenance": record(folder, "gap")}
    write_json(folder / "gap.json", content)
    columns = {n: x.reshape(-1, box.size)[:, j] for j, n in enumerate(states)}
    columns |= {n: np.tile(inputs[:, j], grid.size) for j, n in enumerate(input_names)}
    columns |= {f"gap_{n}": d.reshape(-1, box.size)[:, j] for j, n in enumerate(states)}
    write_parquet(folder / "samples.parquet", table(columns, units, {"case": "example"}, record(folder, "gap")))


def _controller(grid, inputs, states, input_names, kind, box, made):
    centres = grid.centres()
    winning = centres[:, 0] + 0.1 * centres[:, 1] > (0.01 if kind == "gap" else -0.01)
    mask = np.packbits(winning[:, None].repeat(len(inputs), axis=1), axis=1, bitorder="little")
    more = {}
    if box.size == 3:
        target = (centres[:, 0] > 3) & (centres[:, 1] > 3)
        distance = np.ceil(5 * np.hypot(4 - centres[:, 0], 4 - centres[:, 1])).astype(np.int32)
        more = {"value": np.where(winning, np.where(target, 0, distance), -1).astype(np.int32), "target": target}
    solution = Solution(grid=grid, mask=mask, winning=winning, free=np.ones(grid.size, bool), **more)
    return Controller(
        inputs,
        states,
        input_names,
        solution,
        "least_effort",
        made,
    )


def _trace(folder, case, kind, plant, run, safe, inputs, states, input_names, gap, tau, steps, bad):
    rng = np.random.default_rng([run, len(kind), len(plant)])
    n = (steps // 2 if bad else steps) + 1
    s = np.linspace(0.0, 1.0, n)[:, None]
    start, end = safe.lo + 0.2 * (safe.hi - safe.lo), safe.lo + 0.9 * (safe.hi - safe.lo)
    x = start + s * (end - start) + 0.01 * (safe.hi - safe.lo) * rng.standard_normal((n, 1))
    if bad:
        x[-1, 0] = safe.lo[0] - 0.01
    u = inputs[rng.integers(0, len(inputs), n)].astype(float)
    d = gap(x, u)
    u[-1], d[-1] = np.nan, np.nan
    columns = {"run": np.full(n, run), "step": np.arange(n), "sim_time": tau * np.arange(n)}
    columns |= {name: x[:, j] for j, name in enumerate(states)} | {name: u[:, j] for j, name in enumerate(input_names)}
    for prefix, values in (("gap", d), ("lo", d - 1e-3), ("hi", d + 2e-3)):
        columns |= {f"{prefix}_{name}": values[:, j] for j, name in enumerate(states)}
    columns["safe"] = safe.contains(x)
    return table(columns, UNITS[case], {"case": case, "controller": kind, "plant": plant}, record(folder, "validation"))


def read_json(path):
    """Plain JSON, without the package."""
    return json.loads(path.read_text())
