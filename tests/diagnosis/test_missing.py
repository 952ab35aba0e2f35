"""The picture of what the model lacks shows the term that was put into the data, and nothing after the correction."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp
import yaml

from simgap.config.load import parse_case
from simgap.diagnosis.record.record import Record, Trace
from simgap.effects import AppliedEffect, apply_effects
from simgap.model.symbolic import Coordinate, PlanarWheels, SymbolicModel, Variable, symbol
from simgap.plants.plant_model import PlantModel
from simgap.report.missing import missing_terms
from tests.stages import diagnosis_example as example

SIGMA = example.SIGMA


@pytest.fixture(scope="module")
def model():
    return PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path()).corrected


@pytest.mark.parametrize("measured", [("q", "v"), ("q",)])
def test_dry_friction_is_a_step_over_speed(model, measured):
    data = example.record(seconds=40.0)
    (trace,) = data.traces
    part = Record((Trace("bench", trace.t, trace.y[:, : len(measured)], trace.u),), measured, ("u",))
    after = apply_effects(model, [AppliedEffect("coulomb_friction", "hinge", {"F_c": example.FRICTION})])
    (lack,) = missing_terms(part, model, after, {}, SIGMA[: len(measured)])
    assert (lack.label, lack.unit) == ("torque at the hinge", "N*m")
    before, corrected = lack.before["v"], lack.after["v"]
    fast = np.abs(before.centre) > 0.8
    step = -example.FRICTION * np.sign(before.centre)
    for side, true in (
        (before, step),
        (corrected, 0.0 * step),
    ):  # bars are 95 %: twice that is 4 sigma
        assert np.all(np.abs(side.mean - true)[fast] <= 2.0 * side.half[fast] + 0.01)
    assert np.sum(np.abs(corrected.mean[fast])) < 0.2 * np.sum(np.abs(before.mean[fast]))


def test_a_force_of_each_turn_is_seen_over_many_turns():
    speed, ripple, dt = 3.0, 0.2, 0.002
    spinning = SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")), inputs=(Variable("u", "N*m"),), parameters={},
        xdot=(symbol("v"), symbol("u")), coordinates=(Coordinate("axis", "q", "v", "N*m"),),
        force_map={"axis": (sp.Integer(0), sp.Integer(1))},
    )  # fmt: skip
    t = np.arange(20_000) * dt
    q = speed * t  # the input balances the ripple, so that it turns evenly
    held = -ripple * np.sin(3.0 * (q + 0.5 * speed * dt))
    run = Trace("spin", t, np.stack([q, np.full_like(t, speed)], axis=1), held[:, None])
    (lack,) = missing_terms(Record((run,), ("q", "v"), ("u",)), spinning, spinning, {}, np.array([1e-4, 1e-3]))
    seen = lack.before["q"]
    assert lack.folded == {"q"}
    assert np.ptp(seen.centre) <= 2.0 * np.pi
    np.testing.assert_allclose(seen.mean, ripple * np.sin(3.0 * seen.centre), atol=0.04)


def test_a_late_input_shows_only_where_it_is_not_declared(model):
    t = np.arange(4000) / 200.0
    late = 0.05
    exact = example.torque(t - late)
    x, out = np.zeros(2), []
    for u in exact:
        out.append(x.copy())
        for _ in range(20):
            x[1] += (u - example.WEIGHT * np.sin(x[0])) / example.INERTIA / 4000
            x[0] += x[1] / 4000
    data = Record((Trace("late", t, np.array(out), example.torque(t)[:, None]),), ("q", "v"), ("u",))
    (lack,) = missing_terms(data, model, model, {"u": late}, SIGMA)
    spread = [float(np.max(np.abs(side["v"].mean))) for side in (lack.before, lack.after)]
    assert spread[1] < 0.15 * spread[0]


def test_a_planar_robot_is_seen_in_its_own_frame():
    h, v, w = symbol("h"), symbol("v"), symbol("w")
    robot = SymbolicModel(
        states=(Variable("x", "m"), Variable("y", "m"), Variable("h", "rad")),
        inputs=(Variable("v", "m/s"), Variable("w", "rad/s")),
        parameters={},
        xdot=(v * sp.cos(h), v * sp.sin(h), w),
        wheels=PlanarWheels("x", "y", "h", "v", "w", 0.3),
    )
    t = np.arange(3000) / 100.0
    speed, turn = 0.5 + 0.3 * np.sin(t), np.cos(0.7 * t)
    heading = np.concatenate([[0.0], np.cumsum(turn[:-1]) / 100])
    vx = speed * np.cos(heading) - 0.1 * speed * np.sin(heading)  # slips sideways by a tenth of its speed
    vy = speed * np.sin(heading) + 0.1 * speed * np.cos(heading)
    xy = [np.concatenate([[0.0], np.cumsum(c[:-1]) / 100]) for c in (vx, vy)]
    data = Record(
        (Trace("r", t, np.stack([*xy, heading], axis=1), np.stack([speed, turn], axis=1)),), ("x", "y", "h"), ("v", "w")
    )
    forward, sideways, turning = missing_terms(data, robot, robot, {}, np.full(3, 1e-4))
    side = sideways.before["v"]
    np.testing.assert_allclose(side.mean, 0.1 * side.centre, atol=2e-3)
    assert np.max(np.abs(forward.before["v"].mean)) < 5e-3
    assert np.max(np.abs(turning.before["v"].mean)) < 5e-3


def test_nothing_is_drawn_where_a_state_is_unknown(model):
    data = example.record()
    (trace,) = data.traces
    only_speed = Record((Trace("bench", trace.t, trace.y[:, 1:], trace.u),), ("v",), ("u",))
    assert missing_terms(only_speed, model, model, {}, SIGMA[1:]) == ()
