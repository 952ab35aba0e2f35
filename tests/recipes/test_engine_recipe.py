"""The recipe of an engine in one file, followed in a scratch folder: roll-outs and the bound of the gap."""

import numpy as np
import pytest
import yaml
from scratch import block, scratch, snakemake

from simgap.gap.load import from_json
from simgap.io.documents import read_json
from simgap.io.parquet import read_parquet, stack

PAGE, HEADING = "docs/plugins.md", "An engine in a file beside the case"
TAU, FRICTION = 0.01, 0.3


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("engine")
    case = yaml.safe_load(block(PAGE, HEADING, "yaml"))
    scratch(folder, case, {"my_engine.py": block(PAGE, HEADING, "python")})
    log = snakemake(folder, "results/cart/gap/eps~0.25/gap.json")
    return folder, log.stderr


def test_the_rollouts_are_those_of_the_file(made):
    (shard,) = (made[0] / "results/cart/rollouts/eps~0.25").glob("*.parquet")
    rows = read_parquet(shard)
    x, v, force = stack(rows, ["x", "v", "F"]).T
    expected = np.stack([x + TAU * v, v + TAU * (force - FRICTION * v)], axis=1)
    assert np.abs(stack(rows, ["next_x", "next_v"]) - expected).max() < 1e-15


def test_the_bound_is_the_friction(made):
    gap = from_json(read_json(made[0] / "results/cart/gap/eps~0.25/gap.json"))
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (500, 2)), rng.choice([-1.0, 0.0, 1.0], (500, 1))
    lo, hi = gap.bounds(x, u)
    true = np.stack([np.zeros(500), -TAU * FRICTION * x[:, 1]], axis=1)
    assert (lo <= true).all()
    assert (true <= hi).all()
    assert (hi - lo).max() < 1e-5  # of a gap of 3e-3


def test_it_is_told_that_the_file_is_code(made):
    assert "my_engine.py is code and runs with your rights" in made[1]


def test_an_edit_reruns_what_it_simulated(made):
    folder, _ = made
    file = folder / "configs/cases/my_engine.py"
    file.write_text(file.read_text() + "# an edit\n")
    planned = snakemake(folder, "-n", "--quiet", "rules", "--", "results/cart/gap/eps~0.25/gap.json")
    text = planned.stdout + planned.stderr
    assert "rollouts" in text
    assert "fresh" in text
