"""Held-out transitions against f +- gamma: counted by hand on a model whose gap is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import yaml

from simgap.config.gap import GapSection, LipschitzSection
from simgap.config.load import load_case, parse_case
from simgap.diagnosis.record.conditions import conditioned
from simgap.gap.bases import Expressions
from simgap.geometry import Grid
from simgap.io.results import stack
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.report.measured_share import share_inside, transition_columns
from tests.gap.fit_in_memory import GapSamples, fit_gap
from tests.stages import diagnosis_example as example

NOISE = {"q": 1e-3, "v": 1e-2}


class Exact:
    """f is what was measured without noise: x stays, whatever the input."""

    def step(self, x, u):
        return x


@pytest.fixture
def context(vary):
    hinge = {"joint": "hinge"}
    angle, rate = {"quantity": "position", "unit": "rad"}, {"quantity": "velocity", "unit": "rad/s"}
    states = {"q": hinge | angle, "v": hinge | rate}
    domain = {"tau": 0.05, "X": {"q": [-9, 9], "v": [-90, 90]}, "U": {"u": {"values": [-9.0, 0.0, 9.0]}}}
    path = vary("pendulum", {"domain": domain, "plant.states": states})
    return Context(load_case(path), path)


def constant_gap(context, half):
    grid = Grid(context.box, (6, 6))
    d = np.zeros((grid.size, 3, 2))
    samples = GapSamples(grid, context.input_set, d - half, ("q", "v"), ("u",), d + half)
    return fit_gap(
        samples, GapSection(basis=Expressions(terms=("1",)), lipschitz=LipschitzSection(extreme_value=False))
    ).function


def test_the_share_is_that_of_a_count_by_hand(context):
    data = example.record(seed=4)
    rows = pa.table(transition_columns(context, example.windows(data), NOISE, context.plant.corrected, {"u": 0.02}, {}))
    start, then = stack(rows, ["q", "v"]), stack(rows, ["next_q", "next_v"])
    assert len(start) == 3 * 19  # as many as the conformal bound rests on
    half = np.array([0.05, 0.3])
    gap = constant_gap(context, half)
    lo, hi = gap.bounds(start[:1], np.zeros((1, 1)))
    noise = {"q": 0.02, "v": 0.1}
    got = share_inside(context, rows, Exact(), gap, noise, late=False)
    assert got["transitions"] == len(start)
    assert got["share"] == np.mean(np.all((then - start >= lo) & (then - start <= hi), axis=1))
    # two independent normals of sqrt(2) sigma inside the symmetric bound
    from scipy.stats import norm

    want = np.prod([2 * norm.cdf(h / (np.sqrt(2) * s)) - 1 for h, s in zip(half, noise.values(), strict=True)])
    assert got["noise_alone"] == pytest.approx(want, abs=0.05)


def test_files_under_other_conditions_than_the_declared_are_not_held_against_the_bound(context):
    plant = PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path())
    model = conditioned(plant.corrected, ["w"])
    windows = []
    for k, w in enumerate(example.windows(example.record(seed=4))):
        weight = np.full((len(w.t), 1), 1.5 if k % 8 == 2 else 2.5)
        windows.append(replace(w, inputs=np.hstack([w.inputs, weight])))
    both, one = (transition_columns(context, windows, NOISE, model, {}, declared) for declared in ({}, {"w": 1.5}))
    assert len(both["q"]) == 3 * 19
    assert len(one["q"]) == 2 * 19  # of windows 2 and 10, not 6
    assert set(one) == {"q", "v", "u", "late_u", "next_q", "next_v"}


def test_transitions_outside_the_domain_are_not_counted(context):
    data = example.record(seed=4)
    rows = pa.table(transition_columns(context, example.windows(data), NOISE, context.plant.corrected, {}, {}))
    narrow = context.case.model_copy(
        update={"domain": context.domain.model_copy(update={"X": {"q": (50.0, 51.0), "v": (-90.0, 90.0)}})}
    )
    elsewhere = Context(narrow, context.path)
    assert share_inside(elsewhere, rows, Exact(), constant_gap(context, 1.0), {"q": 1.0, "v": 1.0}, False) is None
