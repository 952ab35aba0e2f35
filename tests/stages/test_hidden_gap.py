"""The bound of a robot with memory from made-up roll-outs whose gap is known."""

from pathlib import Path

import numpy as np
import pytest

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.load import from_json
from simgap.gap.sampling.points import Points, step_columns
from simgap.io.results import read_json, table, write_parquet
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.simulators.body_samples import REST, BodySamples
from simgap.stages.gap_inputs import write_points
from tests.stages import road

ROOT = Path(__file__).parents[2]
SMALL = {
    "domain.U": {"v": {"min": -0.2, "max": 0.2, "step": 0.2}, "w": {"min": -0.5, "max": 0.5, "step": 0.5}},
    "simulator.urdf": str(ROOT / "configs/models/turtlebot.urdf"),
    "hidden_state.chains": 4,
    "hidden_state.chain_length": 500,
    "hidden_state.search": 0,  # nothing was simulated, so there is not an engine to search
    "symmetry.histories": 5,
    "symmetry.tolerance": {"x": 0.02, "y": 0.02, "theta": 0.05},
    "hidden_state.classes": {},
}


def made_up(inputs, n, spread, rng, heading_bias=0.1):
    """Explicit Euler plus a gap: x falls 10 % short, the heading `heading_bias` w short, noise within +-spread."""
    m = rng.integers(0, len(inputs), n)
    v, w = inputs[m].T
    final = np.stack([0.9 * v, np.zeros(n), (1.0 - heading_bias) * w], axis=1) + rng.uniform(-spread, spread, (n, 3))
    x = np.stack([np.minimum(final[:, 0], 0), np.maximum(final[:, 0], 0)], axis=1)
    y = np.stack([np.minimum(final[:, 1], 0), np.maximum(final[:, 1], 0)], axis=1)
    before = np.where(np.arange(n) % 5 == 0, REST, np.roll(m, 1))  # sequences of five
    return BodySamples(m, final, np.concatenate([x, y], axis=1), before)


NAMES = (["previous_v", "previous_w"], ["v", "w"])


def again(deviation, n=5, length=4, headings=8):
    """Histories whose response moves by 1e-4 with older inputs and by `deviation` with the heading."""
    final = np.zeros((n, length + headings, 3))
    final[:, : length - 1] = 1e-4
    final[:, length:] = np.array(deviation)
    flat = final.reshape(-1, 3)
    none = np.zeros(len(flat), dtype=np.int64)
    return BodySamples(none, flat, np.zeros((len(flat), 4)), none)


def write(context, path, parts, stage="rollouts"):
    """A table of steps that no simulator made."""
    tables = [step_columns(context.case, context.input_set, own) | {"part": np.full(len(own.m), name)}
              for name, own in parts.items()]  # fmt: skip
    record = provenance(stage, context.case, context.folder)
    write_parquet(path, table({n: np.concatenate([t[n] for t in tables]) for n in tables[0]}, {}, {}, record))


@pytest.fixture
def stage(vary, tmp_path):
    path = vary("turtlebot", SMALL)
    context = Context.load(path)
    inputs, rng = context.input_set, np.random.default_rng(0)
    every = np.tile(np.arange(len(inputs)), 50)
    grid = made_up(inputs, len(every), 0.01, rng)
    kept = [np.flatnonzero(grid.m == k)[: len(inputs)] for k in range(len(inputs))]
    rows = np.array(kept).T.reshape(-1)  # all inputs after each previous one
    grid = BodySamples(
        grid.m[rows], grid.final[rows], grid.extent[rows], np.repeat(np.arange(len(inputs)), len(inputs))
    )

    def run(fresh_spread=0.008, deviation=(0.001, 0.001, 0.001), heading_bias=0.1, steps=2000):
        sequences = made_up(inputs, steps, 0.0101, rng)
        write(
            context,
            tmp_path / "shard.parquet",
            {"after_previous": grid, "sequence": sequences, "history": again(deviation)},
        )
        drawn = {"sequence": made_up(inputs, 2000, fresh_spread, rng, heading_bias)}
        write(context, tmp_path / "fresh.parquet", drawn, "fresh")
        record = provenance("grid", context.case, context.folder)
        write_points(tmp_path / "grid", Points("hidden-state", inputs, inputs), NAMES, {}, record)
        road.bound(path, tmp_path, [tmp_path / "shard.parquet"], tmp_path / "fresh.parquet", tmp_path / "gap.json")
        return context, read_json(tmp_path / "gap.json")

    return run


def test_the_bound_takes_the_bias_out_and_covers_the_spread_at_every_heading(stage):
    context, content = stage()
    gap = from_json(content)
    rng = np.random.default_rng(5)
    u = context.input_set[rng.integers(0, len(context.input_set), 500)]
    heading = rng.uniform(-np.pi, np.pi, 500)
    x = np.stack([rng.uniform(0, 10, 500), rng.uniform(0, 10, 500), heading], axis=1)
    body = np.stack([-0.1 * u[:, 0], np.zeros(500), -0.1 * u[:, 1]], axis=1) + rng.uniform(-0.008, 0.008, (500, 3))
    c, s = np.cos(heading), np.sin(heading)
    d = np.stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1], body[:, 2]], axis=1)
    lo, hi = gap.bounds(x, u)
    assert np.all((lo <= d) & (d <= hi))
    assert np.max(hi[:, 2] - lo[:, 2]) < 0.05  # the bias of up to 0.05 rad is not padded
    assert content["fresh"]["violations"] == 0
    assert (content["fresh"]["samples"], content["fresh"]["steps"]) == (400, 2000)  # sequences are counted
    assert len(content["swept_boxes"]["lower"]) == len(context.input_set)
    assert any("estimate" in g["text"] for g in content["guarantee"])


def test_fresh_sequences_outside_the_bound_break_the_promise(stage):
    with pytest.raises(BrokenPromise, match="does not cover"):
        stage(heading_bias=0.5)


def test_a_symmetry_that_does_not_hold_is_named_with_both_numbers(stage):
    with pytest.raises(BrokenPromise, match=r"0\.3.*0\.05"):
        stage(deviation=(0.001, 0.001, 0.3))


def test_a_part_of_the_histories_makes_no_bound(stage):
    with pytest.raises(UserError, match=r"'sequence': 1500.*'sequence': 2000"):
        stage(steps=1500)
