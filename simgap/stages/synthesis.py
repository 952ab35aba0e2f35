"""Stage `synthesis`: the controller on the abstraction of f with its gap, or of f alone."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from simgap.config.pose import pose_axes
from simgap.geometry import Floats
from simgap.io.controller_file import save_controller
from simgap.io.documents import write_json
from simgap.io.gap_file import SavedGap, load_gap
from simgap.model.paths import nominal_paths
from simgap.model.sampled import NominalModel
from simgap.plants.cases import nominal_model
from simgap.plants.memory import carried_model
from simgap.provenance import provenance
from simgap.simulators.body_samples import BodySamples
from simgap.specifications.solution import Solution
from simgap.stages.context import Context, log
from simgap.synthesis.controller import Controller
from simgap.synthesis.intersample import excursion, rates
from simgap.synthesis.specifications import ReachAvoidSpecification, Specification, make_specification
from simgap.synthesis.sweep import planar_sweep
from simgap.synthesis.synthesise import Problem, synthesise

WAY_POINTS = 20  # poses on the nominal way between two samples


def run(case_path: Path, gap_path: Path | None, out: Path, summary: Path, threads: int = 2) -> None:
    """Synthesise, write the controller and its figures.

    Raises:
        UserError: a specification that does not fit the domain, or that no controller can meet, with the reason.
    """
    context = Context.load(case_path)
    with context.blame():
        problem, between = pose(context, gap_path)
        began = time.perf_counter()
        solution = synthesise(problem, threads)
    log.info("%d of %d cells win (%.4f)", solution.winning.sum(), solution.free.sum(), solution.fraction)
    log.info("synthesis took %.2f s, compilation included", time.perf_counter() - began)
    record = provenance("synthesis", context.case, context.folder)
    section = context.need(context.case.synthesis, "synthesis")
    names = tuple(context.states), tuple(context.inputs)
    save_controller(Controller(problem.inputs, *names, solution, section.rule, record), out)
    figures = {
        "model": "with gap" if gap_path is not None else "nominal",
        "cells": list(problem.cells),
        "inputs": len(problem.inputs),
        "winning_cells": int(solution.winning.sum()),
        "free_cells": int(solution.free.sum()),
        "winning_fraction": solution.fraction,
        "winning_fraction_after_inflation": after_inflation(case_specification(context), solution, between),
        "between_samples": dict(zip(context.states, between.tolist(), strict=True)),
        "looks_between_samples": gap_path is not None or section.nominal_between_samples,
        "statistics": solution.statistics,
        "provenance": record,
    }
    write_json(summary, figures)


def after_inflation(specification: Specification, solution: Solution, between: Floats) -> float | None:
    """Share of winning cells among those that also keep clear of obstacles by what may happen between samples."""
    if not isinstance(specification, ReachAvoidSpecification):
        return None
    free = specification.with_clearance(between).free(solution.grid)
    return float((solution.winning & free).sum() / max(1, free.sum()))


def case_specification(context: Context) -> Specification:
    """What the case asks for, with the clearance as written there."""
    section = context.need(context.case.synthesis, "synthesis")
    return make_specification(section.specification.model_dump(), tuple(context.states), context.box)


def pose(context: Context, gap_path: Path | None) -> tuple[Problem, Floats]:
    """The synthesis problem of a case, and how far a path may stray from its samples, (nx,).

    The controller made with the gap minds the way between samples; that of the nominal model alone only if asked to.
    """
    section = context.need(context.case.synthesis, "synthesis")
    model = nominal_model(context.case, context.folder)
    bound = load_gap(gap_path, context) if gap_path is not None else None
    gap = bound.function if bound is not None else None
    specification = case_specification(context)
    reaching = isinstance(specification, ReachAvoidSpecification)
    on_the_way = reaching and (bound is not None or section.nominal_between_samples)
    sweep = _sweep(context, model, bound) if on_the_way else None
    flow = rates(carried_model(context.case.plant, context.folder))
    spread = np.array([s.size for s in gap.sup().values()]) if gap is not None and sweep is None else np.zeros(model.nx)
    between, _ = excursion(flow, specification.region, context.input_set, model.tau, spread / model.tau)
    sensing = context.case.sensing
    error = np.array([sensing.error.get(name, 0.0) for name in context.states]) if sensing else None
    problem = Problem(
        model=model,
        specification=specification.with_clearance(between) if on_the_way and sweep is None else specification,
        cells=section.cells,
        inputs=context.input_set,
        periodic=tuple(context.states.index(name) for name in context.domain.periodic),
        gap=gap.kernel() if gap is not None else None,
        gap_axes=[j for j in range(model.nx) if j not in gap.domain.free] if gap is not None else None,
        error=error,
        latency=sensing.latency if sensing else 0,
    )
    if sweep is not None:
        problem = replace(problem, sweep=planar_sweep(problem.grid, *sweep, pose_axes(context)))
    return problem, between


def _sweep(context: Context, model: NominalModel, bound: SavedGap | None) -> tuple[Floats, Floats] | None:
    """The box of each input's way, seen from the robot: measured with the gap, or the nominal way without one.

    None for a plant that is no wheeled robot: the clearance then covers what happens between samples.
    """
    symbolic = context.case.plant.symbolic
    if symbolic is None or symbolic.wheels is None:
        return None
    if bound is not None:
        return bound.sweep
    pose = pose_axes(context)
    symbolic_plant = carried_model(context.case.plant, context.folder)
    way, bulge = nominal_paths(
        symbolic_plant, context.case.plant.integrator, model.tau, np.zeros(model.nx), context.input_set, WAY_POINTS
    )
    extent = BodySamples.of_paths(np.arange(len(way)), way[..., list(pose)]).extent
    return extent[:, [0, 2]] - bulge, extent[:, [1, 3]] + bulge
