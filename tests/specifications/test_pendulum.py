"""Reaching a box, and staying in it, for a plant that is no robot: the pendulum in PyBullet, from case to runs."""

import numpy as np
import pytest

from simgap.config.gap import GapSection, LipschitzSection
from simgap.gap.bases import Expressions
from simgap.gap.sampling.points import product
from simgap.geometry import Grid
from simgap.io.results import read_json, read_parquet, write_json
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import synthesis, validation
from tests.gap.fit_in_memory import GapSamples, fit_gap

OBSTACLE = {"x1": [-0.15, 0.0], "x2": [-0.4, 0.4]}
TARGETS = {
    "reach_avoid": {"x1": [-0.5, -0.3], "x2": [-0.5, 0.5]},
    "reach_and_stay": {"x1": [0.1, 0.4], "x2": [-0.5, 0.5]},
}
TERMS = ("sin(x1)", "x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")
STEPS = 150


@pytest.fixture
def case(vary):
    def make(kind):
        changes = {
            "plant.integrator": "rk4",
            "domain": {
                "tau": 0.02,
                "X": {"x1": [-0.6, 0.6], "x2": [-1.5, 1.5]},
                "U": {"u": {"min": -3.0, "max": 3.0, "step": 0.5}},
            },
            "simulator.substeps": 4,
            "synthesis": {
                "cells": [240, 200],
                "specification": {"kind": kind, "target": TARGETS[kind], "obstacles": [OBSTACLE]},
            },
            "validation": {"starts": 20, "steps": STEPS, "seed": 2, "kept": 20},
        }
        return vary("pendulum", changes, remove=["measured"])

    return make


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return tmp_path_factory.mktemp("pendulum") / "gap.json"


def bound(path, out):
    """A bound fitted to roll-outs on a coarse grid; the same for both targets."""
    if out.exists():
        return out
    context = Context.load(path)
    grid = Grid.covering(context.box, 0.05)
    x, u = product(grid.centres(), context.input_set)
    ((following, _),) = run_in_processes(roll_out, [(context.case, context.folder, x, u)])
    d = following - context.plant.sampled.step(x, u)
    samples = GapSamples(grid, context.input_set, d.reshape(grid.size, -1, 2), ("x1", "x2"), ("u",))
    settings = GapSection(basis=Expressions(terms=TERMS), lipschitz=LipschitzSection(extreme_value=False))
    record = provenance("gap", context.case, context.folder)
    write_json(out, fit_gap(samples, settings).function.to_json() | {"provenance": record})
    return out


def runs(path):
    """The states of the kept runs of the gap-aware controller in the simulator, (k + 1, 2) each."""
    rows = [r for r in read_parquet(path).to_pylist() if (r["controller"], r["plant"]) == ("gap", "simulator")]
    count = 1 + max(r["run"] for r in rows)
    return [np.array([[r["x1"], r["x2"]] for r in rows if r["run"] == k]) for k in range(count)]


def within(x, named):
    return np.all([(x[:, j] >= lo) & (x[:, j] <= hi) for j, (lo, hi) in enumerate(named.values())], axis=0)


@pytest.mark.parametrize("kind", TARGETS)
def test_every_run_keeps_what_it_was_promised(case, shared, tmp_path, kind):
    path = case(kind)
    gap = bound(path, shared)
    made, figures = tmp_path / "controller.npz", tmp_path / "synthesis.json"
    synthesis.run(path, gap, made, figures, 1)
    said = read_json(figures)
    assert said["winning_fraction"] > 0.5
    assert min(said["between_samples"].values()) > 0.01  # what the clearance had to cover
    validation.run(path, made, made, gap, tmp_path / "v.json", tmp_path / "traces.parquet", 1)
    tally = read_json(tmp_path / "v.json")["controllers"]["gap"]["simulator"]
    assert tally["runs_that_kept_the_specification"] == tally["runs"] == 20
    assert tally["steps_outside_gamma"] == tally["steps_that_left_the_certified_box"] == 0
    assert tally["least_clearance_in_widths_of_X"] > 0
    traces = runs(tmp_path / "traces.parquet")
    assert not any(within(x, OBSTACLE).any() for x in traces)
    assert max(tally["steps_to_target"]) > 5  # some starts are far away
    for x, arrived in zip(traces, tally["steps_to_target"], strict=True):
        assert within(x[arrived:], TARGETS[kind]).all()
        assert len(x) == (STEPS + 1 if kind == "reach_and_stay" else arrived + 1)
