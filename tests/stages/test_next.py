"""A small swing cannot tell a spring from a heavier gravity; the proposed recording does."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.errors import UserError
from simgap.extras import next as stage
from simgap.stages import diagnosis

CASE = """\
name: bench
plant:
  states: {q: {unit: rad}, v: {unit: rad/s}}
  inputs: {u: {unit: N*m}}
  symbolic:
    parameters: {m: {value: 1.0, unit: kg}, l: {value: 0.3, unit: m}, g: {value: 9.81, unit: m/s^2}}
    dynamics: {q: v, v: (u - m*g*l*sin(q)) / (m*l^2)}
    coordinates: {hinge: {position: q, velocity: v, force_gain: 1/(m*l^2)}}
domain:
  tau: 10 ms
  X: {q: [-3, 3], v: [-12, 12]}
  U: {u: {min: -3, max: 3, step: 0.5}}
measured:
  effects: [spring, viscous_friction, parameter_error]
"""
STIFFNESS, RATE = 0.15, 100.0


def play(path, u, seed):
    """The bench with a spring that the case lacks, by SciPy."""
    x = np.zeros((len(u), 2))
    for k in range(len(u) - 1):
        pull = lambda _, s, f=u[k]: [s[1], (f - STIFFNESS * s[0] - 9.81 * 0.3 * np.sin(s[0])) / 0.09]  # noqa: E731
        x[k + 1] = solve_ivp(pull, (0.0, 1.0 / RATE), x[k], rtol=1e-8, atol=1e-10).y[:, -1]
    q = x[:, 0] + 1e-3 * np.random.default_rng(seed).standard_normal(len(u))
    t = np.arange(len(u)) / RATE
    np.savetxt(path, np.column_stack([t, q, u]), delimiter=",", header="t,q,u", comments="")
    return path


def answers(document):
    return {(e["name"], e["on"]) for e in document["effects"]}


def test_the_proposed_recording_tells_what_the_first_could_not(tmp_path):
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    small = play(tmp_path / "small.csv", 0.06 * np.sin(2 * np.pi * 0.7 * np.arange(800) / RATE), 0)
    first = diagnosis.run(case, [small], tmp_path / "found")
    rivals = answers(first) | {(e["name"], e["on"]) for a in first["alternatives"] for e in a["effects"]}
    assert rivals >= {("spring", "hinge"), ("parameter_error", "g")}  # the confusion

    said = stage.run(case, tmp_path / "found", tmp_path / "next", seconds=6.0)
    assert said["probability"] > 0.99
    assert "cannot separate" in said["paragraph"]
    assert (tmp_path / "next" / "next.png").stat().st_size > 0
    assert json.loads((tmp_path / "next" / "next.json").read_text())["paragraph"] == said["paragraph"]
    table = np.genfromtxt(tmp_path / "next" / "input.csv", delimiter=",", names=True)
    assert np.allclose(np.diff(table["t"]), 0.01)
    assert table["t"][-1] == pytest.approx(6.0)
    assert np.abs(table["u"]).max() <= 3.0

    brief = stage.run(case, tmp_path / "found", tmp_path / "brief")  # no length given: as short as is enough
    assert 2.0 < brief["seconds"] < brief["longest"]["seconds"] == pytest.approx(7.99)
    assert brief["probability"] >= brief["asked"] == 0.95
    assert brief["shown"] <= brief["longest"]["shown"]
    assert f"{brief['seconds']:.3g} s are enough; 7.99 s would make it" in brief["paragraph"]
    assert said["asked"] is None
    assert said["seconds"] == said["longest"]["seconds"] == pytest.approx(6.0)

    second = play(tmp_path / "second.csv", table["u"], 1)
    then = diagnosis.run(case, [small, second], tmp_path / "settled")
    assert then["verdict"] == "attributed"
    assert answers(then) == {("spring", "hinge")}
    assert then["alternatives"] == []
    assert then["effects"][0]["parameters"]["k"]["value"] == pytest.approx(STIFFNESS, rel=0.02)

    alone = stage.run(case, tmp_path / "settled", tmp_path / "again", seconds=4.0)  # nothing to tell apart: its number
    assert alone["probability"] is None
    assert "present width" in alone["paragraph"]
    for words, change in (
        ("no explanations", {"effects": [], "verdict": "none"}),
        ("three joints", {"joints": []}),
    ):
        (tmp_path / "bad").mkdir(exist_ok=True)
        stage.write_json(tmp_path / "bad" / "diagnosis.json", {k: v for k, v in then.items() if k != "sha256"} | change)
        with pytest.raises(UserError, match=words):
            stage.run(case, tmp_path / "bad", tmp_path / "none")
    with pytest.raises(UserError, match="not states"):
        stage.run(case, tmp_path / "found", tmp_path / "none", start={"angle": 1.0})
    with pytest.raises(UserError, match="is too short"):
        stage.run(case, tmp_path / "found", tmp_path / "none", seconds=0.2)
