"""The gap of a case with a declared planar symmetry: what is rolled out, and the bound that comes of it.

`rollouts` calls `roll_out_part` for each of `parts(case)`, `gap` calls `fit_parts` on the tables in the same order.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from simgap.config.case import Case
from simgap.dynamics.build import symbolic_model
from simgap.dynamics.cases import nominal_model
from simgap.dynamics.paths import nominal_paths
from simgap.gap.function import GapDomain
from simgap.gap.hidden_state import (
    BodySamples,
    BodySweep,
    HiddenStateFit,
    fading,
    fit_hidden_state,
    previous_inputs,
    random_sequences,
    tolerance_of,
)
from simgap.gap.symmetry import HeadingDeviation, check_symmetry, heading_deviation, nominal_motion
from simgap.gap.tiers import FreshCheck, clopper_pearson_upper
from simgap.geometry import Floats
from simgap.io.parquet import stack, table
from simgap.provenance import provenance
from simgap.simulators import wheeled_rollouts as engine
from simgap.simulators.process import run_in_processes
from simgap.simulators.wheeled import wheeled_plant
from simgap.stages.context import Context

EXTENT = ("x_least", "x_largest", "y_least", "y_largest")
FADED = 100  # histories on which the influence of older inputs is measured


def parts(case: Case) -> tuple[str, ...]:
    """Names of the tables: shards of the grid of previous inputs, random sequences, two measurements, fresh samples."""
    shards = case.grid.shards if case.grid else 2
    return (*(f"previous-{k}" for k in range(shards)), "sequences", "histories", "headings", "fresh")


def roll_out_part(context: Context, part: str, log: Path | None = None) -> pa.Table:
    """Run one part in the engine's process.

    Raises:
        UserError: a case without the sections `hidden_state`, `symmetry`, `simulator`.
    """
    case, folder, inputs = context.case, context.folder, context.input_set
    hidden, symmetry = context.need(case.hidden_state, "hidden_state"), context.need(case.symmetry, "symmetry")
    name, _, shard = part.partition("-")
    if name == "previous":
        values = [context.domain.U[n].list() for n in context.inputs]
        every = previous_inputs(values, [hidden.previous[n] for n in context.inputs])
        own = np.array_split(every, len(parts(case)) - 4)[int(shard)]
        ((samples, version),) = run_in_processes(engine.after_previous, [(case, folder, own, inputs)], log=log)
        return _samples_table(context, part, samples, version)
    if name in ("sequences", "fresh"):
        seed = hidden.seed if name == "sequences" else hidden.seed + 1_000_003
        n = hidden.chains if name == "sequences" else hidden.fresh_chains
        drawn = random_sequences(inputs, n, hidden.chain_length, np.random.default_rng(seed))
        ((samples, version),) = run_in_processes(engine.along_sequences, [(case, folder, drawn, inputs, seed)], log=log)
        return _samples_table(context, part, samples, version)
    if name == "histories":
        drawn = random_sequences(inputs, FADED, hidden.length + 1, np.random.default_rng(hidden.seed + 1))
        (after,) = run_in_processes(engine.with_longer_histories, [(case, folder, drawn, inputs)], log=log)
        return _measured_table(context, part, np.arange(1.0, len(after) + 1), fading(after), after.shape[1])
    drawn = random_sequences(inputs, symmetry.histories, 2, np.random.default_rng(symmetry.seed))
    ((reference, turned),) = run_in_processes(
        engine.at_headings, [(case, folder, drawn, inputs, symmetry.headings, symmetry.seed)], log=log
    )
    deviation = heading_deviation(reference, turned)
    return _measured_table(context, part, np.zeros(1), deviation.largest[None], deviation.samples)


def fit_parts(context: Context, tables: dict[str, pa.Table]) -> tuple[HiddenStateFit, FreshCheck, dict[str, Any]]:
    """The bound from all parts, its check on the fresh one, and what gap.json says besides.

    Raises:
        BrokenPromise: a symmetry outside its tolerance, a history that still matters.
    """
    case, inputs, states = context.case, context.input_set, tuple(context.states)
    hidden, symmetry = context.need(case.hidden_state, "hidden_state"), context.need(case.symmetry, "symmetry")
    plant = wheeled_plant(case, context.folder)
    deviation = HeadingDeviation(
        stack(tables["headings"], _named(states))[0], int(tables["headings"]["samples"][0].as_py())
    )
    check_symmetry(deviation, states, tolerance_of(states, symmetry.tolerance))
    model = nominal_model(case, context.folder)
    centre = 0.5 * (context.box.lo + context.box.hi)
    motion = nominal_motion(model.step, centre, inputs, plant.pose, np.random.default_rng(symmetry.seed))
    grid = engine.joined([_samples(tables[p], states) for p in parts(case) if p.startswith("previous")])
    domain = GapDomain(states, tuple(context.inputs), context.box, inputs, plant.pose[:2])
    fit = fit_hidden_state(
        domain,
        motion,
        grid,
        _samples(tables["sequences"], states),
        stack(tables["histories"], _named(states)),
        deviation,
        bulge(case),
        hidden.growth,
        plant.pose,
    )
    check = check_samples(fit, motion, _samples(tables["fresh"], states))
    function = fit.gap.with_tiers([*fit.gap.tiers, check.tier])
    content = function.to_json() | {
        "sweep": {"lower": fit.sweep.lower.tolist(), "upper": fit.sweep.upper.tolist()},
        "sup": {s: asdict(v) for s, v in function.sup().items()},
        "fresh": asdict(check),
        "hidden_state": {
            "excess": fit.excess.tolist(), "margin": fit.margin.tolist(),
            "influence_of_older_inputs": fit.memory.tolist(),
        },
        "symmetry": {"deviation": deviation.largest.tolist(), "samples": deviation.samples},
    }  # fmt: skip
    return fit, check, content


def bulge(case: Case) -> float:
    """How far the robot's way may leave the line between recorded poses: friction cannot accelerate it beyond mu g."""
    section: Any = case.simulator
    step = (case.domain.tau if case.domain else 0.0) / section.poses
    return float(section.floor_friction * case.plant.gravity * step**2 / 8.0)


def check_samples(fit: HiddenStateFit, motion: Floats, fresh: BodySamples, confidence: float = 0.95) -> FreshCheck:
    """Violations of the body-frame bound and of the swept box among fresh samples."""
    d, m = fresh.final - motion[fresh.m], fresh.m
    excess = np.maximum(fit.gap.lower[m] - d, d - fit.gap.upper[m])
    left = (fresh.extent[:, [0, 2]] < fit.sweep.lower[m]) | (fresh.extent[:, [1, 3]] > fit.sweep.upper[m])
    rows = (excess > 0).any(axis=1) | left.any(axis=1)
    states, count = fit.gap.domain.states, int(rows.sum())
    bad = (excess > 0).sum(axis=0)
    first = tuple(
        ([0.0] * 3, fit.gap.domain.input_set[m[k]].tolist(), d[k].tolist()) for k in np.flatnonzero(rows)[:10]
    )
    return FreshCheck(
        len(m),
        count,
        {s: int(b) for s, b in zip(states, bad, strict=True)},
        {s: float(max(e, 0.0)) for s, e in zip(states, excess.max(axis=0), strict=True)},
        clopper_pearson_upper(len(m), count, confidence),
        confidence,
        first,
    )


def nominal_sweep(case: Case, folder: Path, inputs: Floats, poses: int = 20) -> BodySweep:
    """The swept box of the nominal model alone, for the controller that knows no gap."""
    pose = wheeled_plant(case, folder).pose
    model, tau = symbolic_model(case.plant, folder), case.domain.tau if case.domain else 0.0
    way, out = nominal_paths(model, case.plant.integrator, tau, np.zeros(3), inputs, poses)
    extent = BodySamples.of_paths(np.arange(len(inputs)), way, pose).extent
    return BodySweep(extent[:, [0, 2]] - out, extent[:, [1, 3]] + out)


def saved_sweep(content: dict[str, Any]) -> BodySweep:
    """The sweep that `fit_parts` put into gap.json."""
    return BodySweep(np.array(content["sweep"]["lower"]), np.array(content["sweep"]["upper"]))


def _named(states: tuple[str, ...]) -> list[str]:
    return [f"body_{s}" for s in states]


def _samples_table(context: Context, part: str, samples: BodySamples, version: str) -> pa.Table:
    states, u = context.states, context.input_set[samples.m]
    columns = {"input": samples.m.astype(np.float64)} | {n: u[:, j] for j, n in enumerate(context.inputs)}
    columns |= {f"body_{s}": samples.final[:, i] for i, s in enumerate(states)}
    columns |= {name: samples.extent[:, j] for j, name in enumerate(EXTENT)}
    units = (
        context.units | {f"body_{s}": context.units[s] for s in states} | dict.fromkeys(EXTENT, "m") | {"input": "1"}
    )
    record = provenance("rollouts", context.case, context.folder, {}, engine=version)
    return table(columns, units, {"case": context.case.name, "part": part, "engine": version}, record)


def _samples(rolled: pa.Table, states: tuple[str, ...]) -> BodySamples:
    m = rolled["input"].to_numpy().astype(np.int64)
    return BodySamples(m, stack(rolled, _named(states)), stack(rolled, list(EXTENT)))


def _measured_table(context: Context, part: str, back: Floats, values: Floats, samples: int) -> pa.Table:
    columns = {"back": back, "samples": np.full(len(back), float(samples))}
    columns |= {f"body_{s}": values[:, i] for i, s in enumerate(context.states)}
    units = {f"body_{s}": context.units[s] for s in context.states} | {"back": "1", "samples": "1"}
    record = provenance("rollouts", context.case, context.folder, {})
    return table(columns, units, {"case": context.case.name, "part": part}, record)
