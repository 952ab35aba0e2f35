"""The bound of a robot with memory from made-up roll-outs whose gap is known."""

from pathlib import Path

import numpy as np
import pytest

from simgap.errors import BrokenPromise
from simgap.gap.load import from_json
from simgap.io.documents import read_json, write_json
from simgap.simulators.body_samples import BodySamples
from simgap.stages import hidden_gap
from simgap.stages.context import Context
from simgap.stages.histories import write_samples

ROOT = Path(__file__).parents[2]
SMALL = {
    "domain.U": {"v": {"min": -0.2, "max": 0.2, "step": 0.2}, "w": {"min": -0.5, "max": 0.5, "step": 0.5}},
    "simulator.urdf": str(ROOT / "configs/models/turtlebot.urdf"),
}


def made_up(inputs, n, spread, rng, heading_bias=0.1):
    """Explicit Euler plus a gap: x falls 10 % short, the heading `heading_bias` w short, noise within +-spread."""
    m = rng.integers(0, len(inputs), n)
    v, w = inputs[m].T
    final = np.stack([0.9 * v, np.zeros(n), (1.0 - heading_bias) * w], axis=1) + rng.uniform(-spread, spread, (n, 3))
    x = np.stack([np.minimum(final[:, 0], 0), np.maximum(final[:, 0], 0)], axis=1)
    y = np.stack([np.minimum(final[:, 1], 0), np.maximum(final[:, 1], 0)], axis=1)
    return BodySamples(m, final, np.concatenate([x, y], axis=1))


@pytest.fixture
def stage(vary, tmp_path):
    path = vary("turtlebot", SMALL)
    context = Context.load(path)
    inputs, rng = context.input_set, np.random.default_rng(0)
    every = np.tile(np.arange(len(inputs)), 50)
    grid = made_up(inputs, len(every), 0.01, rng)
    kept = [np.flatnonzero(grid.m == k)[:20] for k in range(len(inputs))]
    assert min(len(k) for k in kept) == 20
    rows = np.array(kept).T.reshape(-1)  # 20 previous inputs, all inputs after each
    grid = BodySamples(grid.m[rows], grid.final[rows], grid.extent[rows])

    def run(fresh_spread=0.008, deviation=(0.001, 0.001, 0.001), heading_bias=0.1):
        write_samples(context, tmp_path / "grid.parquet", grid, None, "made up")
        write_samples(context, tmp_path / "random.parquet", made_up(inputs, 2000, 0.0101, rng), 2, "made up")
        fresh = made_up(inputs, 2000, fresh_spread, rng, heading_bias)
        write_samples(context, tmp_path / "fresh.parquet", fresh, 3, "made up", "fresh")
        memory = {"memory": np.full((3, 3), 1e-4), "largest_deviation": list(deviation), "compared": 10}
        write_json(tmp_path / "memory.json", memory | {"previous_inputs": 20})
        names = ("grid.parquet", "random.parquet", "memory.json", "fresh.parquet", "gap.json", "samples.parquet")
        hidden_gap.run(path, *(tmp_path / name for name in names))
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
    assert len(content["sweep"]["lower"]) == len(context.input_set)
    assert any("estimate" in g["text"] for g in content["guarantee"])


def test_fresh_sequences_outside_the_bound_break_the_promise(stage):
    with pytest.raises(BrokenPromise, match="does not cover"):
        stage(heading_bias=0.5)


def test_a_symmetry_that_does_not_hold_is_named_with_both_numbers(stage):
    with pytest.raises(BrokenPromise, match=r"0\.3.*0\.05"):
        stage(deviation=(0.001, 0.001, 0.3))
