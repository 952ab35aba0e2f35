"""A simulator with noise from its case to the adversary: what is promised, counted and said."""

import json

import numpy as np
import pytest
import yaml

from simgap.attack.campaign import Campaign
from simgap.attack.witness import DISTURBANCE, SIMULATOR
from simgap.attack.worst_step import SearchRecord
from simgap.closed_loop import BEYOND, Judge
from simgap.errors import BrokenPromise, UserError
from simgap.extras import certify, shield
from simgap.gap.noise import NoiseStatement
from simgap.io.results import read_parquet
from simgap.plants.context import Context
from simgap.stages import audit, fresh, synthesis, validation
from tests.stages import road

CASE = """
name: brake
plant:
  states: {v: {unit: m/s}}
  inputs: {F: {unit: N}}
  symbolic: {dynamics: {v: F}}
domain: {tau: 0.1, X: {v: [-1, 1]}, U: {F: {values: [-1, 0, 1]}}}
simulator:
  engine: equations
  integrator: rk4
  slopes: sampled
  equations: {dynamics: {v: F - 0.2*v}}
  noise: {v: {normal: 0.01}}
grid: {eps: 0.1, shards: 1}
gap: {basis: [v, F, 1], fresh_samples: 2000, noise: {alpha: 0.02}, lipschitz: {extreme_value: false}}
synthesis: {cells: [80], specification: {kind: invariance, safe: {v: [-0.5, 0.5]}}}
validation: {starts: 20, steps: 50, seed: 1}
audit: {evaluations: 300, steps: 300}
"""


def bounded(folder, seed=0, rolled=road.roll_out):
    """Bound of the case, from `rolled` out samples: -> case file, shards."""
    folder.mkdir()
    content = yaml.safe_load(CASE)
    content["simulator"]["noise_seed"] = seed
    case = folder / "case.yaml"
    case.write_text(yaml.safe_dump(content, sort_keys=False))
    shards = rolled(case, folder)
    fresh.run(case, folder / "fresh.parquet", None, 1)
    road.bound(case, folder, shards, folder / "fresh.parquet", folder / "gap.json")
    return case, shards


def test_from_the_case_to_the_adversary(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    case, shards = bounded(folder)
    bound = json.loads((folder / "gap.json").read_text())
    assert bound["noise"] == {"alpha": 0.02, "confidence": 0.99, "samples": 30, "draws": bound["noise"]["draws"]}
    assert "with a probability of at least 98 %" in bound["guarantee"][0]["text"]
    assert "at every state of X and input of U, rounding included" not in json.dumps(bound["guarantee"])
    (own,) = bound["dimensions"]
    expected = 2 * 0.01 * np.sqrt(2 * np.log(bound["noise"]["draws"]))  # of the extremes of normal numbers
    assert 0.7 * expected < own["mean_width"] < 1.3 * expected
    fresh.run(case, folder / "fresh-2.parquet", None, 2)
    assert (folder / "fresh-2.parquet").read_bytes() == (folder / "fresh.parquet").read_bytes()

    for kind, gap in (("nominal", None), ("aware", folder / "gap.json")):
        synthesis.run(case, gap, folder / f"{kind}.npz", folder / f"{kind}.json", 1)
    controllers = folder / "nominal.npz", folder / "aware.npz"
    validation.run(case, *controllers, folder / "gap.json", folder / "v.json", folder / "traces.parquet", 1)
    found = json.loads((folder / "v.json").read_text())
    assert found["noise"].startswith("A run of 50 steps keeps its promise with a probability of at least 36.4 %")
    assert found["controllers"]["gap"]["simulator"]["steps"] == 1000

    ends = {"stayed": 1, BEYOND: 1}
    few = {"runs": 2, "steps": 10, "runs_that_violated_it": 1, "steps_outside_gamma": 1, "ends": ends}
    monkeypatch.setattr(Judge, "count", lambda judge, *_: (few if judge.noisy else few | {"ends": {}}, {}))
    driven = shield._drive(case, folder / "gap.json", folder / "aware.npz", "random", 1)
    monkeypatch.undo()
    validation.keep_promise(driven["shielded"], *driven["judged_by"])  # one step in 10 may be chance

    files = audit.AuditFiles(folder / "gap.json", folder / "aware.npz", shards, folder / "fresh.parquet")
    audit.run(case, files, audit.AuditOutputs(folder / "a.json", folder / "m.parquet", folder / "w.json"), 1)
    attacked = json.loads((folder / "a.json").read_text())
    assert attacked["violations"] == 0
    assert attacked["evaluations"] == 300
    with pytest.raises(UserError, match="simulator with noise may leave it"):
        certify.run(case, folder / "gap.json", folder / "aware.npz", folder / "certificate")


def test_a_bound_that_is_too_narrow_for_the_noise_is_found_out_by_fresh_samples(tmp_path):
    def narrow(case, folder):
        context, shards = Context.load(case), road.roll_out(case, folder)
        rolled = {name: read_parquet(shards[0]).column(name).to_numpy() for name in ("v", "F")}
        x, u = rolled["v"][:, None], rolled["F"][:, None]
        following = x * np.exp(-0.02) + 0.1 * u
        spread = following - 0.01, following + 0.01
        road.made_up_borders(context, folder / "borders.parquet", lambda x, u: -0.02 * x)
        return [road.made_up(context, shards[0], x, u, following, spread)]

    with pytest.raises(BrokenPromise, match=r"tolerated probability 0\.02"):
        bounded(tmp_path / "run", rolled=narrow)


def test_another_seed_gives_another_bound_and_the_same_one_the_same(tmp_path):
    texts = []
    for k, seed in enumerate((0, 0, 1)):
        bounded(tmp_path / f"{k}", seed)
        texts.append((tmp_path / f"{k}" / "gap.json").read_text())
    assert texts[0] == texts[1]
    assert json.loads(texts[0])["dimensions"] != json.loads(texts[2])["dimensions"]


def test_the_adversary_judges_the_share_outside_in_closed_loop_alone():
    noise = NoiseStatement(0.01, 0.99, 0, 0)
    search = SearchRecord(evaluations=100, violations=50)

    def violations(outside, noise):
        loops = {SIMULATOR: Campaign(steps=1000, outside_gamma=outside), DISTURBANCE: Campaign(violations=2)}
        return audit.counts(search, loops, ["v"], noise)["violations"]

    assert violations(5, noise) == 2
    assert violations(30, noise) == 32
    assert violations(5, None) == 52
