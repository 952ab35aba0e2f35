"""The recipe of an engine in one file, followed in a scratch folder: roll-outs and the bound of the gap."""

import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.io.results import read_parquet, stack
from simgap.provenance import code_digest
from tests.recipes.scratch import block, gap_of, scratch

PAGE, HEADING = "docs/how-to/plugins.md", "An engine in a file beside the case"
TAU, FRICTION = 0.01, 0.3


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("engine")
    case = yaml.safe_load(block(PAGE, HEADING, "yaml"))
    path = scratch(folder, case, {"my_engine.py": block(PAGE, HEADING, "python")})
    return path, gap_of(path)


def test_the_rollouts_are_those_of_the_file(made):
    rows = read_parquet(made[0].parent / "shard.parquet")
    x, v, force = stack(rows, ["x", "v", "F"]).T
    expected = np.stack([x + TAU * v, v + TAU * (force - FRICTION * v)], axis=1)
    assert np.abs(stack(rows, ["next_x", "next_v"]) - expected).max() < 1e-15


def test_the_bound_is_the_friction(made):
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (500, 2)), rng.choice([-1.0, 0.0, 1.0], (500, 1))
    lo, hi = made[1].bounds(x, u)
    true = np.stack([np.zeros(500), -TAU * FRICTION * x[:, 1]], axis=1)
    assert (lo <= true).all()
    assert (true <= hi).all()
    assert (hi - lo).max() < 1e-5  # of a gap of 3e-3


def test_it_is_told_that_the_file_is_code(made):
    folder = made[0].parent
    log = (folder / "grid.log").read_text()
    assert f"plug-in file {folder / 'my_engine.py'} is code and runs with your permissions" in log


def test_an_edit_reruns_what_it_simulated(made):
    path = made[0]

    def digests():
        stages = ("grid", "rollouts", "fresh", "validation", "synthesis", "lipschitz")
        return {s: code_digest(s, load_case(path), path.parent) for s in stages}

    before = digests()
    (path.parent / "my_engine.py").write_text(block(PAGE, HEADING, "python") + "# an edit\n")
    after = digests()
    # The slopes too: an engine whose step is known in closed form has them enclosed and not sampled.
    assert {s for s in before if before[s] != after[s]} == {"rollouts", "fresh", "validation", "lipschitz"}
