"""Shipped cases with a task, at reduced size, from the case file to a certificate that the checker accepts."""

import json

import numpy as np
import pytest
import tampering

from simgap.extras import certify
from simgap.stages import fresh, synthesis
from tests.stages import road

HELD = {"kind": "task", "formula": "F G held", "regions": {"held": {"i": [1.15, 1.55], "v": [1.09, 1.17]}}}
REDUCED = {
    "dcdc": {"grid.eps": 0.02, "synthesis.cells": [120, 120], "synthesis.specification": HELD},
    "swing_up": {"grid.half_widths": {"q": 0.16, "v": 0.4}, "synthesis.cells": [150, 150]},
}
"""A converter in equations that is to come to its set and stay there, and a pendulum in PyBullet."""


@pytest.mark.parametrize("name", REDUCED)
def test_a_task_of_a_shipped_case_is_certified_whole(vary, tmp_path, name):
    path = vary(name, REDUCED[name] | {"gap.fresh_samples": 500, "gap.lipschitz": {"extreme_value": False}})
    drawn, gap, out = (tmp_path / n for n in ("fresh.parquet", "gap.json", "controller.npz"))
    fresh.run(path, drawn, workers=1)
    road.bound(path, tmp_path, road.roll_out(path, tmp_path), drawn, gap)
    synthesis.run(path, gap, out, tmp_path / "synthesis.json", threads=1)
    certify.run(path, gap, out, tmp_path / "certificate")
    status, false, words = tampering.judged(tmp_path / "certificate", np.arange(0), np.random.default_rng(1))
    assert (status, false) == (0, None), words
    head = json.loads((tmp_path / "certificate/certificate.json").read_text())
    assert head["kind"] == "task"
    assert f"'{head['formula']}' holds of every run that the automaton accepts" in words
    assert np.load(tmp_path / "certificate/winning.npy").mean() > 0.1
