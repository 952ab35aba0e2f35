"""A unit or a sign is a possibility of its own: no gain beside it may make it another one."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.config.plant import PlantSection
from simgap.diagnosis.diagnose import diagnose, ready
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import columns
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.parts import parts_of
from simgap.plants.plant_model import declared_model
from tests.diagnosis.plants import point_pendulum
from tests.undeclared.nominals import EQUATIONS
from tests.undeclared.rig import robot, textbook
from tests.undeclared.rig.textbook import Hidden
from tests.undeclared.test_robot import _declared


def _left(part):
    return columns._beside_effects(columns._begun(part, np.inf), np.inf)


def test_a_unit_is_not_saved_by_a_reversed_gain_far_from_one(monkeypatch):
    """A robot that turns the other way, half as fast, read at 7.8 Hz: turns a minute and a gain of -4.7 fit as well."""
    monkeypatch.setattr(robot, "RATE", 1.0 / 0.128)
    runs = robot.record({"turn_gain": -0.497}, np.random.default_rng([1, 83]), heading=True)
    record = Record(tuple(Trace(f"run{k}", *r) for k, r in enumerate(runs)), ("x", "y", "theta"), ("v", "w"))
    parts, _ = parts_of(_declared(), record, DiagnosisSettings(window_s=2.0, horizon_s=2.0))
    whole = coarse(parts.known)
    part = whole.on(whole.windows.pick(np.linspace(0, len(whole.windows) - 1, 8).astype(int)))
    options = {(o.finding.fault, o.finding.channel, o.words): o for o in columns._options(part)}
    unit = options["wrong_unit", "w", "w in turns a minute"]
    reversed_ = options["wrong_sign", "w", ""]
    assert _left(unit.applied(part)) > 100.0
    assert _left(reversed_.applied(part)) == pytest.approx(1.0, abs=0.2)
    found = columns.better_columns(whole, (), {})
    assert found is None or not found.sure  # the sign is left to the gain that the search finds


@pytest.mark.parametrize(
    ("inertia", "factor", "found"), [(0.0007, 1.0, None), (0.018, 1e-3, "wrong_unit"), (0.018, 1.0, None)]
)
def test_a_unit_that_leaves_nothing_of_the_plant_is_none(inertia, factor, found):
    """A bench whose drive turns far more than the declared arm: the model misses by more than a straight line does.

    Readings a thousand times too large are a straight line to it. Of the right model a thousandth is told all the same.
    """
    rng, t = np.random.default_rng(7919), np.arange(0.0, 12.0, 0.01)
    runs = []
    for k in range(2):
        u = 0.3 * np.sin(np.outer(t, rng.uniform(1.0, 9.0, 4)) + rng.uniform(0.0, 6.0, 4)).mean(axis=1)

        def slope(s, x, u=u):
            return x[1], (np.interp(s, t, u) - 0.05 * 9.81 * 0.15 * np.sin(x[0])) / 0.018

        x = solve_ivp(slope, (0.0, 12.0), (0.3, 0.0), t_eval=t, rtol=1e-8).y.T
        runs.append(Trace(f"run{k}", t, factor * (x + rng.normal(0.0, (2e-3, 2e-2), x.shape)), u[:, None]))
    record = Record(tuple(runs), ("angle", "rate"), ("torque",))
    settings = DiagnosisSettings(window_s=0.5, horizon_s=0.2)
    parts, _ = parts_of(point_pendulum(0.05, 0.15, inertia), record, settings)
    better = columns.better_columns(coarse(parts.known), (), {})
    assert ((better and better.sure and better.finding.fault) or None) == found


def _counted(k: int, counts: float) -> Trace:
    """A pendulum whose friction depends on the place, which no effect is; its commands in counts, so many a newton
    metre."""
    rng, t = np.random.default_rng([k, 7933]), np.arange(1000) / 100.0
    u = np.sin(np.outer(t, rng.uniform(0.6, 12.0, 6)) + rng.uniform(0.0, 6.0, 6)).sum(axis=1)

    def slope(s, x):
        held = u[min(int(100.0 * s + 1e-9), len(u) - 1)]
        return x[1], (held - 4.905 * np.sin(x[0]) - 0.15 * (1.0 + 0.8 * np.sin(7.0 * x[0])) * x[1]) / 0.3

    x = solve_ivp(slope, (0.0, t[-1]), (0.3, 0.0), t_eval=t, rtol=1e-8, max_step=0.01).y[:1].T
    return Trace(f"run{k}", t, x + 1e-3 * rng.standard_normal(x.shape), counts * u[:, None])


@pytest.mark.parametrize(("counts", "verdict"), [(1.0, "partial"), (21.0, "unexplained")])
def test_a_gain_beyond_belief_is_told_as_a_unit_and_nothing_is_named_in_its_place(counts, verdict):
    record = Record(tuple(_counted(k, counts) for k in range(3)), ("angle",), ("torque",))
    few = DiagnosisSettings(effects=("viscous_friction", "coulomb_friction", "input_gain", "input_dead_zone"))
    found = diagnose(point_pendulum(1.0, 0.5, 0.3), record, few)
    assert found.verdict == verdict
    if counts == 1.0:
        assert [(e.name, e.on) for e in found.effects] == [("viscous_friction", "hinge")]
    else:
        assert any("units" in reason for reason in found.nearest.reasons)
        (gain,) = [e for e in found.nearest.effects if e.on == "torque"]
        assert gain.parameters["ratio"].value == pytest.approx(1.0 / counts, rel=0.05)


@pytest.mark.parametrize(("factor", "noise"), [(180.0 / np.pi, {}), (180.0 / np.pi, {"angle": 2e-3}), (1.0, {})])
def test_a_unit_that_the_declared_model_alone_shows_faintly_is_told_by_what_predicts(factor, noise):
    """A pendulum let go, read in degrees, heavier to turn than declared: friction bends the wrong unit near it."""
    rng, t = np.random.default_rng(7951), np.arange(0.0, 24.0, 0.02)
    swing = solve_ivp(
        lambda s, x: (x[1], -9.81 * 0.3 * 0.5 / 0.083 * np.sin(x[0]) - 0.08 * x[1]), (0.0, 24.0), (0.35, 0.0),
        t_eval=t, rtol=1e-9,
    ).y[0]  # fmt: skip
    y = factor * (swing + rng.normal(0.0, 2e-3, len(t)))
    record = Record((Trace("swing", t, y[:, None], np.zeros((len(t), 1))),), ("angle",), ("torque",))
    d = diagnose(point_pendulum(0.3, 0.5, 0.075), record, DiagnosisSettings(window_s=1.0, horizon_s=0.5, noise=noise))
    told = [(f.fault, f.channel) for f in d.recording]
    assert told == ([("wrong_unit", "angle")] if factor > 1.0 else [])
    assert d.verdict in ("attributed", "partial")
    assert d.after.horizon_rmse["angle"] < 0.005


@pytest.mark.parametrize(("inductance", "rate"), [(0.002, 40.0), (0.0004, 100.0)])
@pytest.mark.parametrize(
    "hidden", [Hidden(gain={"V": 0.3}), Hidden(coulomb={"shaft": 0.05}), Hidden(factors={"J": 2.0})]
)
def test_a_stiff_motor_that_is_read_slowly_has_its_columns_right(inductance, rate, hidden):
    """Its winding settles within a reading: a step as long as that diverges, and says nothing of columns."""

    def rates(x, u, f, r):
        turn = (0.05 * x[2] + f[0]) / (0.002 * r.get("J", 1.0))
        return np.array([x[1], turn, (u[0] - x[2] - 0.05 * x[1]) / inductance])

    made = replace(textbook.dc_motor(), rates=rates, rate=rate)
    runs = textbook.runs(made, hidden, 77, seconds=6.0)
    equations = copy.deepcopy(EQUATIONS["dc_motor"])
    equations["symbolic"]["parameters"]["L"]["value"] = inductance
    model = declared_model(PlantSection.model_validate(equations), None)
    record = Record(tuple(Trace(f"run{k}", *run) for k, run in enumerate(runs)), made.measured, made.inputs)
    (seen,) = ready(model, record, DiagnosisSettings())
    assert seen.faults == ()
