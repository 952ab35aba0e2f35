"""Bounds other than the scenario program, from the case file through every stage to the closed loop."""

import numpy as np
import pytest
import yaml

from simgap.gap.bounds.load import from_json
from simgap.io.results import read_json
from simgap.stages import fresh, synthesis, validation
from tests.stages import road

SMALL = {
    "domain": {"tau": 0.005, "X": {"x1": [-0.2, 0.2], "x2": [-0.5, 0.5]},
               "U": {"u": {"min": -1.2, "max": 1.2, "step": 0.4}}},
    "grid": {"eps": 0.02, "shards": 1},
    "synthesis": {"cells": [200, 100], "specification": {"kind": "invariance", "safe": {"x1": [0.0, 0.2]}}},
    "validation": {"starts": 10, "steps": 100, "seed": 1},
}  # fmt: skip
BOUNDS = {
    "envelope": {"bound": "envelope"},
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bounds")


@pytest.fixture(scope="module")
def results(folder, root):
    """What every stage wrote: {bound: (gap.json, validation.json)}; the roll-outs are shared."""
    case = yaml.safe_load((root / "configs/cases/pendulum.yaml").read_text())
    case["plant"]["urdf"] = str(root / "configs/models/pendulum.urdf")
    case |= SMALL
    del case["measured"]
    checked = folder / "fresh.parquet"
    found = {}
    for name, section in BOUNDS.items():
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(case | {"gap": case["gap"] | {"fresh_samples": 3000} | section}))
        if not found:
            shards = road.roll_out(path, folder)
            fresh.run(path, checked, workers=1)
        bound, made, judged = (folder / f"{name}.{end}" for end in ("gap", "npz", "validation"))
        road.bound(path, folder, shards, checked, bound)
        synthesis.run(path, bound, made, folder / "synthesis.json", 1)
        validation.run(path, made, made, bound, judged, folder / "traces", 1)
        found[name] = read_json(bound), read_json(judged)
    return found


@pytest.mark.parametrize("name", BOUNDS)
def test_from_the_case_to_the_closed_loop(results, folder, name):
    found, judged = results[name]
    share = found["fresh"]["violations"] / found["fresh"]["samples"]
    tiers = [tier["tier"] for tier in found["guarantee"]]
    text = " ".join(tier["text"] for tier in found["guarantee"])
    tally = judged["controllers"]["gap"]["simulator"]
    assert tally["runs_that_violated_it"] == 0
    assert all(0.0 < d["mean_width"] <= d["sup_width"] * (1 + 1e-6) for d in found["dimensions"])
    assert share == 0.0
    assert tiers == [1, 2, 3, 3]
    assert "estimates" in text
    assert tally["steps_outside_gamma"] == 0


def test_the_mean_width_of_an_envelope_is_that_between_its_nodes(results):
    """An envelope has no width at its nodes; on average over a cell it is L h, both sides of it."""
    found, _ = results["envelope"]
    slopes, function = np.array(found["slopes"]), from_json(found)
    h = np.array([0.5 * np.diff(found["edges"][s]).mean() for s in ("x1", "x2")])
    for i, dimension in enumerate(found["dimensions"]):
        assert dimension["mean_width"] == pytest.approx(slopes[i] @ h, rel=0.02)
    nodes = np.stack([np.array(found["nodes"][s])[:3] for s in ("x1", "x2")], axis=1)
    lo, hi = function.bounds(nodes, np.full((3, 1), 0.4))
    assert (hi - lo).max() < 1e-14
