"""Stage `synthesis`: the controller on the abstraction of f with its gap, or of f alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from simgap.arrays import Floats
from simgap.effects import effect
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.geometry import Box
from simgap.io.controller_file import save_controller
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.results import read_json, write_json
from simgap.lint.costs import affordable, costs
from simgap.model.integrators import nominal_paths
from simgap.model.sampled import NominalModel
from simgap.plants.context import Context, pose_axes
from simgap.provenance import CONTROLLED
from simgap.simulators.body_samples import BodySamples
from simgap.simulators.commands import acts_at_once
from simgap.specifications.base import path_aware_baseline, specification_of
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.stages import CasePath, Option, Out, log
from simgap.synthesis.abstraction.intersample import Flow, SweptCells, excursion, flow_of, planar_swept_cells
from simgap.synthesis.controller import Controller
from simgap.synthesis.explain import GammaParts, explain
from simgap.synthesis.games.game import PreviousBounds
from simgap.synthesis.synthesise import EmptyDomain, SynthesisProblem, synthesise

FIRST_INPUT = 1e-9  # how far the first input may be from the one of U that it is
EMPTY_FIGURES = "empty.json"  # which the page of a run without a controller shows
PATH_POINTS = 20  # poses on the nominal path between two samples


def run(
    case_path: CasePath,
    gap_path: Annotated[Path | None, Option("gap.json; the nominal model alone if not given.", "--gap")],
    out: Out,
    summary: Annotated[Path, Option("File for the figures of the synthesis (JSON).")],
    threads: Annotated[int, Option("Threads.", "--workers")] = 2,
    baseline: Annotated[
        bool, Option("Without a gap: check the path between samples (fair baseline).", "--baseline")
    ] = False,
) -> None:
    """Synthesise, write the controller and its figures.

    Args:
        gap_path: gap.json; None for the nominal model alone.
        baseline: whether the nominal-only controller checks the path between samples, whatever the case says.

    Raises:
        UserError: a specification that does not fit the domain, or that no controller can meet, with the reason.
    """
    summary.with_name(EMPTY_FIGURES).unlink(missing_ok=True)  # of an earlier run that won nothing
    context = Context.load(case_path)
    record = context.record("synthesis", rests=CONTROLLED[1:] if gap_path is not None else ())
    if baseline:
        context = path_aware_baseline(context)
    with context.blame():
        affordable(context, [cost for cost in costs(context) if cost.stage == "synthesis"])
        problem, between = pose_problem(context, gap_path)
        began = time.perf_counter()
        about = {
            "model": "with gap" if gap_path is not None else "nominal",
            "cells": list(problem.cells),
            "inputs": len(problem.inputs),
        }
        solution = _solved(context, problem, gap_path, about | {"provenance": record}, summary, threads)
    log.info("%d of %d cells win (%.4f)", solution.winning.sum(), solution.free.sum(), solution.fraction)
    log.info("synthesis took %.2f s, compilation included", time.perf_counter() - began)
    section = context.need(context.case.synthesis, "synthesis")
    names = tuple(context.states), tuple(context.inputs)
    by = "swept boxes" if problem.swept is not None else "clearance" if problem.stray is not None else None
    save_controller(Controller(problem.inputs, *names, solution, section.rule, record), out)
    figures = about | {
        "winning_cells": int(solution.winning.sum()),
        "free_cells": int(solution.free.sum()),
        "winning_fraction": solution.fraction,
        "winning_fraction_after_inflation": after_inflation(problem, solution, between),
        "between_samples": _by_state(context, between[0]),
        "between_samples_beyond_walls": _by_state(context, between[1]),
        "between_samples_by": by,
        "looks_between_samples": gap_path is not None or section.nominal_between_samples,
        "statistics": solution.statistics,
        "provenance": record,
    }
    write_json(summary, figures)


def _solved(
    context: Context,
    problem: SynthesisProblem,
    gap_path: Path | None,
    about: dict[str, Any],
    summary: Path,
    threads: int,
) -> Solution:
    """The solution; where there is none, why: in the summary and in a file beside it.

    Raises:
        EmptyDomain: no cell wins.
    """
    try:
        return synthesise(problem, threads)
    except EmptyDomain as error:
        found = explain(problem, _retimed(context), threads, _parts(context, gap_path))
        asked = problem.specification.sentence(problem.space)
        figures = about | {"asked": asked, "winning_cells": 0, "empty": found.to_json()}
        for file in (summary, summary.with_name(EMPTY_FIGURES)):  # a failed job of the workflow loses its outputs
            write_json(file, figures)
        raise EmptyDomain(f"{error.problem}: {found.sentence}", file=error.file, key=error.key) from None


def _parts(context: Context, gap_path: Path | None) -> dict[str, GammaParts]:
    """Parts of the gamma of each state; nothing for a bound over hidden state or for the model alone."""
    section = context.case.gap
    dimensions = read_json(gap_path).get("dimensions") or [] if gap_path is not None and section is not None else []
    late = [e for e in context.plant.effects if effect(e.name).remembers]
    left = tuple(f"{e.name} of {e.on}" for e in late if effect(e.name).memory_state(e.on) not in context.states)
    found = {}
    for d in dimensions:
        if "largest_sampled_gap" in d and section is not None:
            boxes = [b.by.get(d["state"], 0.0) for b in section.remainder_within]
            remainder = max(section.remainder.get(d["state"], 0.0), *boxes, 0.0)
            found[d["state"]] = GammaParts(d["largest_sampled_gap"], d["sup_size"], remainder, left)
    return found


def _retimed(context: Context) -> Callable[[float], NominalModel] | None:
    """The nominal model at other sampling times, where it does not carry a delay of one sample."""
    tau = context.domain.tau
    if context.case.sensing is not None and context.case.sensing.latency:
        return None
    return lambda times: replace(context.plant, tau=tau * times).sampled


def _between(context: Context, flow: Flow, region: Box, extra: Floats, needed: bool) -> Floats:
    """Distances by which a path may stray from its samples, and beyond walls that hold them, (2, nx).

    Infinite where no bound is found and none is promised.

    Raises:
        BrokenPromise: no bound, where the specification promises something between samples.
    """
    try:
        return excursion(flow, region, context.input_set, context.domain.tau, extra, context.states)[0]
    except BrokenPromise as error:
        if needed:
            raise
        log.warning("no promise between samples, and no bound on the path there: %s", error)
        return np.full((2, len(context.states)), np.inf)


def _by_state(context: Context, between: Floats) -> dict[str, float]:
    """Bounds by state; empty where there are none."""
    return dict(zip(context.states, between.tolist(), strict=True)) if np.isfinite(between).all() else {}


def after_inflation(problem: SynthesisProblem, solution: Solution, between: Floats) -> float | None:
    """Share of winning cells among those that also keep clear of everything by `between`, (2, nx).

    That is what may happen between samples.
    """
    if not problem.specification.between_samples or not np.isfinite(between).all():
        return None
    free = problem.specification.free(problem.space, solution.grid, between)
    return float((solution.winning & free).sum() / max(1, free.sum()))


def pose_problem(context: Context, gap_path: Path | None) -> tuple[SynthesisProblem, Floats]:
    """The synthesis problem of a case, and how far a path may stray from its samples and beyond walls, (2, nx).

    The gap-aware controller checks the path between samples; the nominal-only one where the case says so.
    """
    section = context.need(context.case.synthesis, "synthesis")
    if section.record == "one" and section.rule != "least_effort":
        raise UserError(
            f"one input a cell is the one of least effort, not the one that '{section.rule}' picks",
            key="synthesis.record", remedy="Set `record: all`, or leave out `rule`.",
        )  # fmt: skip
    model = context.plant.sampled
    bound = load_gap(gap_path, context) if gap_path is not None else None
    gap = bound.function if bound is not None else None
    specification, space = specification_of(context.case), Space.of(context.case)
    on_the_path = specification.between_samples and (bound is not None or section.nominal_between_samples)
    sensing = context.case.sensing
    error = space.vector(sensing.error) if sensing else None
    on_boxes = specification.swept_boxes and specification.on_floor(space)
    boxes_do = on_the_path and on_boxes and not specification.on_true_cells
    swept = _swept(context, model, bound) if boxes_do else None
    symbolic = context.case.plant.symbolic
    wheeled = symbolic is not None and symbolic.wheels is not None
    flow = flow_of(context.plant.carried, smooth=acts_at_once(context.case) and not wheeled)
    spread = np.array([s.size for s in gap.sup().values()]) if gap is not None and swept is None else np.zeros(model.nx)
    needed = on_the_path and swept is None
    between = _between(context, flow, specification.region(space), spread / model.tau, needed)
    problem = SynthesisProblem(
        model=model,
        specification=specification,
        space=space,
        cells=section.cells,
        inputs=context.input_set,
        gap=gap.kernel() if gap is not None else None,
        gap_axes=gap.domain.read if gap is not None else None,
        error=error,
        latency=sensing.latency if sensing else 0,
        first=_first_input(context, sensing.first_input) if sensing and sensing.first_input else None,
        stray=between if needed else None,
        one=section.record == "one",
    )
    if swept is not None:
        problem = replace(problem, swept=planar_swept_cells(problem.grid, *swept, pose_axes(context), error))
    if bound is not None and isinstance(gap, BodyFrameGap) and gap.classes.count > 1:
        problem = replace(problem, previous=_previous(context, problem, bound, gap))
    return problem, between


def _previous(context: Context, problem: SynthesisProblem, bound: SavedGap, gap: BodyFrameGap) -> PreviousBounds:
    """The bound and the swept cells after each class of the previous input."""
    classes = gap.classes
    gaps = tuple(gap.after(c) for c in range(classes.count))
    swept: list[SweptCells | None] = [None] * classes.count
    if problem.swept is not None and bound.swept_by_class is not None:
        boxes = zip(*bound.swept_by_class, strict=True)
        swept = [planar_swept_cells(problem.grid, *own, pose_axes(context), problem.error) for own in boxes]
    return PreviousBounds(classes.kind, classes.rest, gaps, tuple(swept))


def _first_input(context: Context, named: dict[str, float]) -> int:
    """The number of the input that acts in the first sample where measurements come late.

    Raises:
        UserError: one that is not in U.
    """
    if sorted(named) != sorted(context.inputs):
        remedy = f"Give a value for each of {', '.join(context.inputs)}"
        raise UserError(f"the first input names {', '.join(named)}", key="sensing.first_input", remedy=remedy)
    off = np.abs(context.input_set - [named[name] for name in context.inputs]).max(axis=1)
    if off.min() > FIRST_INPUT:
        raise UserError(f"{named} is not in U", key="sensing.first_input", remedy="Take one of the inputs of domain.U")
    return int(np.argmin(off))


def _swept(context: Context, model: NominalModel, bound: SavedGap | None) -> tuple[Floats, Floats] | None:
    """The swept box of each input, seen from the robot: measured with the gap, or of the nominal path without one.

    None for a plant that is no wheeled robot: the clearance then covers what happens between samples.
    """
    symbolic = context.case.plant.symbolic
    if symbolic is None or symbolic.wheels is None:
        return None
    if bound is not None:
        return bound.swept
    every, rest = context.input_set, np.zeros(model.nx)
    path, bulge = nominal_paths(
        context.plant.carried, context.case.plant.integrator, model.tau, rest, every, PATH_POINTS
    )
    extent = BodySamples.of_paths(np.arange(len(path)), path[..., list(pose_axes(context))]).extent
    return extent[:, [0, 2]] - bulge, extent[:, [1, 3]] + bulge
