"""The stage that holds a simulator in equations against the engine that it stands for."""

import json

import pytest
import yaml

from simgap.cli import main
from simgap.errors import BrokenPromise
from simgap.io.gap_file import load_gap
from simgap.plants.context import Context
from simgap.stages import fresh, twin
from tests.stages.road import bound, roll_out

SMALL = {"grid.eps": 0.03, "grid.shards": 2, "gap.fresh_samples": 500, "domain.U": {"u": {"values": [-1.2, 0.1, 1.2]}}}


@pytest.fixture
def proven(root, vary):
    shipped = yaml.safe_load((root / "configs/cases/pendulum_proven.yaml").read_text())

    def make(**changes):
        sections = {"simulator": shipped["simulator"], "twin": shipped["twin"]}
        return vary("pendulum", SMALL | sections | changes, ["measured"])

    return make


@pytest.fixture
def samples(tmp_path):
    def make(path):
        shards, drawn = roll_out(path, tmp_path), tmp_path / "fresh.parquet"
        fresh.run(path, drawn, workers=1)
        return shards, drawn

    return make


def test_every_sample_is_taken_again_and_the_largest_difference_is_written(proven, samples, tmp_path):
    path = proven()
    shards, drawn = samples(path)
    command = ["twin", str(path), *(w for s in shards for w in ("--rollouts", str(s))), "--fresh", str(drawn)]
    with pytest.raises(SystemExit) as done:
        main([*command, "--out", str(tmp_path / "twin.json"), "--log", str(tmp_path / "log")])
    assert done.value.code == 0
    found, context = json.loads((tmp_path / "twin.json").read_text()), Context.load(path)
    assert found["samples"] == {"grid": 10 * 24 * 3, "fresh": 500, "closed_loop": 0}
    assert "pybullet" in found["engine"]
    for name in context.states:
        assert 0.0 <= found["largest"][name]["difference"] < 1e-15
    assert "largest difference to pybullet" in (tmp_path / "log").read_text()


def test_a_twin_that_is_none_fails_and_writes_nothing(proven, samples, tmp_path):
    path = proven()
    shards, drawn = samples(path)
    content = yaml.safe_load(path.read_text())
    content["twin"]["of"]["inertia"] = "file"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BrokenPromise, match="x1 by up to"):
        twin.run(path, shards, drawn, tmp_path / "twin.json")
    assert not (tmp_path / "twin.json").exists()


def test_the_bound_of_a_case_in_equations_is_proven(proven, samples, tmp_path):
    path = proven()
    shards, drawn = samples(path)
    bound(path, tmp_path, shards, drawn, tmp_path / "gap.json")
    gap = load_gap(tmp_path / "gap.json", Context.load(path)).function
    assert {tier.level for tier in gap.tiers} == {1, 3}  # nothing is an estimate
    content = json.loads((tmp_path / "gap.json").read_text())
    assert all(d["lipschitz"]["proven"] for d in content["dimensions"])
    assert content["dimensions"][0]["lipschitz_estimates"][0]["method"] == "interval enclosure"
