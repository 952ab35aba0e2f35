"""Policies that know nothing of a controller, in PyBullet: alone they fail, through its shield none does."""

import json

import pytest

from simgap.cli import main
from simgap.errors import UserError
from simgap.extras import shield
from simgap.stages import fresh, synthesis
from tests.stages import road

POLICIES = """
def largest(x):
    return 1.2

def toward_the_border(x):
    return [1.2 if x[0] > 0.1 else -1.2]

def two(x):
    return [0.0, 1.0]
"""
SMALL = {
    "grid.eps": 0.012,
    "domain.U.u.step": 0.3,
    "gap.fresh_samples": 500,
    "synthesis.cells": [160, 80],
    "validation": {"starts": 4, "steps": 400, "seed": 1},
}


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    return tmp_path_factory.mktemp("shield")


@pytest.fixture
def made(vary, shared):
    """Case, bound and controller of a small pendulum in PyBullet; the last two are made once."""
    case = vary("pendulum", SMALL, remove=("measured",))
    gap, controller = shared / "gap.json", shared / "controller.npz"
    if not controller.exists():
        fresh.run(case, shared / "fresh.parquet", workers=1)
        road.bound(case, shared, road.roll_out(case, shared), shared / "fresh.parquet", gap)
        synthesis.run(case, gap, controller, shared / "synthesis.json", 1)
    return case, gap, controller


@pytest.mark.parametrize("policy", ["random", "largest", "toward_the_border"])
def test_a_policy_in_pybullet(made, tmp_path, policy):
    case, gap, controller = made
    (tmp_path / "own.py").write_text(POLICIES)
    named = policy if policy == "random" else f"{tmp_path}/own.py:{policy}"
    found = shield.run(case, named, 10, controller, gap)
    assert found["alone"]["runs_that_violated_it"] == 10
    assert found["shielded"]["runs_that_violated_it"] == found["shielded"]["steps_outside_gamma"] == 0
    assert found["samples"] == found["shielded"]["steps"] == 10 * 400
    assert 0.05 < found["acted"] / found["samples"] < 0.9


def test_the_command(made, tmp_path, capsys):
    case, gap, controller = made
    files = ["--controller", str(controller), "--gap", str(gap), "--runs", "2"]
    for more in ([], ["--json"]):
        with pytest.raises(SystemExit) as ended:
            main(["shield", str(case), *files, *more])
        assert ended.value.code in (0, None)
        told = capsys.readouterr().out
        if more:
            assert json.loads(told)["shielded"]["runs"] == 2
        else:
            assert "Through the shield: 0 of 2 runs violate the specification, 800 steps" in told
    (tmp_path / "own.py").write_text(POLICIES)
    with pytest.raises(UserError, match=r"an input is 1 numbers \(u\)"):
        shield.run(case, f"{tmp_path}/own.py:two", 1, controller, gap)
