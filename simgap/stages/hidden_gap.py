"""Stage `hidden_gap`: the bound of the gap of a robot with memory, seen from the robot, checked on fresh sequences."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from simgap.config.pose import pose_axes
from simgap.errors import BrokenPromise
from simgap.gap.fresh_check import FreshCheck, check_fresh
from simgap.gap.function import GapDomain
from simgap.gap.hidden_state import HiddenStateFit, fit_hidden_state, tolerance_of
from simgap.gap.symmetry import HeadingDeviation, check_symmetry, nominal_motion
from simgap.geometry import Floats
from simgap.io.documents import read_json, write_json
from simgap.io.parquet import read_parquet, stack, table, write_parquet
from simgap.provenance import provenance
from simgap.simulators.body_samples import BodySamples
from simgap.stages.context import Context, log
from simgap.stages.gap import THINNED, tolerate
from simgap.stages.histories import EXTENTS

LONGER = "Raise hidden_state.chains or hidden_state.previous, or set hidden_state.tolerated_probability."


def run(case_path: Path, grid: Path, random: Path, memory: Path, fresh: Path, out: Path, thinned: Path) -> None:
    """Fit the body-frame bound and the swept boxes, check them on fresh sequences, write them.

    Raises:
        BrokenPromise: a symmetry that does not hold, a memory that does not fade, or violations on fresh sequences.
    """
    context = Context.load(case_path)
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    section = context.need(context.case.simulator, "simulator")
    measured = read_json(memory)
    pose = pose_axes(context)
    with context.blame():
        model = context.plant.sampled
        context.plant.check_with_drake(context.box, context.input_set)
        centre = 0.5 * (context.box.lo + context.box.hi)
        motion = nominal_motion(model.step, centre, context.input_set, pose, np.random.default_rng(0))
        deviation = HeadingDeviation(np.array(measured["largest_deviation"]), int(measured["compared"]))
        check_symmetry(deviation, context.states, tolerance_of(context.states, symmetry.tolerance))
        domain = GapDomain(
            tuple(context.states), tuple(context.inputs), context.box, context.input_set, tuple(sorted(pose[:2]))
        )
        fit = fit_hidden_state(
            domain,
            motion,
            read_samples(context, grid),
            read_samples(context, random),
            np.array(measured["memory"]),
            deviation,
            section.between_poses(context.domain.tau, context.case.plant.gravity),
            hidden.growth,
            pose,
        )
    check = _check(context, fit, motion, fresh)
    log.info("%s", check.tier.text)
    tolerate(check, hidden.tolerated_probability, LONGER)
    write_parquet(thinned, thin(context, read_samples(context, grid), motion))
    write_json(out, content(context, fit, check, measured, len(read_parquet(grid, ["input"]))))


def read_samples(context: Context, path: Path) -> BodySamples:
    """What stage `histories` or `fresh` wrote."""
    rows = read_parquet(path)
    final = stack(rows, [f"moved_{n}" for n in context.states])
    return BodySamples(rows.column("input").to_numpy(), final, stack(rows, list(EXTENTS)))


def _check(context: Context, fit: HiddenStateFit, motion: Floats, fresh: Path) -> FreshCheck:
    """Fresh sequences against the bound at heading 0, where the robot's frame is the world's, and against the sweep.

    Raises:
        BrokenPromise: when a fresh way leaves the swept box of its input.
    """
    samples = read_samples(context, fresh)
    x = np.zeros((len(samples.m), 3))
    x[:] = 0.5 * (context.box.lo + context.box.hi)
    x[:, pose_axes(context)[2]] = 0.0
    d = samples.final - motion[samples.m]
    beyond = np.maximum(
        fit.sweep.lower[samples.m] - samples.extent[:, [0, 2]], samples.extent[:, [1, 3]] - fit.sweep.upper[samples.m]
    )
    if (beyond > 0).any():
        raise BrokenPromise(
            f"{int((beyond > 0).any(axis=1).sum())} of {len(beyond)} fresh ways leave the swept box of their input, "
            f"by up to {beyond.max():.3g} m",
            "Raise hidden_state.chains or hidden_state.previous.",
        )
    return check_fresh(fit.gap, x, context.input_set[samples.m], d)


def thin(context: Context, samples: BodySamples, motion: Floats) -> pa.Table:
    """Evenly spaced steps with their gap, seen from the robot, in the shape of the gap stage's samples."""
    rows = np.unique(np.linspace(0, len(samples.m) - 1, min(len(samples.m), THINNED)).astype(int))
    m = samples.m[rows]
    columns = {n: np.zeros(len(rows)) for n in context.states}
    columns |= {n: context.input_set[m, j] for j, n in enumerate(context.inputs)}
    d = samples.final[rows] - motion[m]
    columns |= {f"gap_{n}": d[:, j] for j, n in enumerate(context.states)}
    units = context.units | {f"gap_{n}": context.units[n] for n in context.states}
    return table(columns, units, {"case": context.case.name}, provenance("hidden_gap", context.case, context.folder))


def content(
    context: Context, fit: HiddenStateFit, check: FreshCheck, measured: dict[str, Any], rolled: int
) -> dict[str, Any]:
    """gap.json of a robot: the bound, the swept boxes, what they rest on."""
    hidden = context.need(context.case.hidden_state, "hidden_state")
    function = fit.gap.with_tiers([*fit.gap.tiers, check.tier])
    size = np.maximum(np.abs(fit.gap.lower), np.abs(fit.gap.upper))
    width = fit.gap.upper - fit.gap.lower
    suprema = function.sup()
    dimensions = [
        {
            "state": name,
            "largest_sampled_gap": float(np.abs(fit.d[..., i]).max()),
            "sup_size": suprema[name].size,
            "sup_width": suprema[name].width,
            "mean_size": float(size[:, i].mean()),
            "mean_width": float(width[:, i].mean()),
            "beyond_previous_inputs": float(fit.excess[i]),
            "margin": float(fit.margin[i]),
        }
        for i, name in enumerate(context.states)
    ]
    seeds = {"histories": hidden.seed, "fresh": hidden.fresh_seed}
    return {
        **function.to_json(),
        "sweep": {"lower": fit.sweep.lower, "upper": fit.sweep.upper},
        "samples": rolled,
        "dimensions": dimensions,
        "memory": measured["memory"],
        "heading_deviation": measured["largest_deviation"],
        "budget": {
            "previous_inputs": measured["previous_inputs"],
            "random_sequences": hidden.chains,
            "steps_of_each": hidden.chain_length,
            "substeps": context.case.simulator.substeps if context.case.simulator else None,
        },
        "fresh": asdict(check),
        "provenance": provenance("hidden_gap", context.case, context.folder, seeds),
    }
