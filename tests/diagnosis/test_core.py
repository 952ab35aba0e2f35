"""Noise floor, windows, sensitivities, least squares, equivalences and verdicts of the diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.diagnosis.diagnose import diagnose, ready
from simgap.diagnosis.record.folds import confirm_mask, split_windows
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.selection import select
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import begun
from simgap.diagnosis.simulation.sensitivity import choose_steps, linearise, slot_direction
from simgap.errors import UserError
from tests.diagnosis.plants import block, one_window, point_pendulum, with_effect


def test_noise_floor_sees_noise_and_not_motion_over_uneven_stamps():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.008, 6000))
    y = np.sin(2 * np.pi * 1.5 * t) + 1e-3 * rng.standard_normal(6000)
    record = Record((Trace("a", t, y[:, None], np.zeros((6000, 1))),), ("q",), ("u",))
    assert noise_floor(record)[0] == pytest.approx(1e-3, rel=0.05)


def test_windows_hold_every_sample_once_and_stay_within_traces():
    traces = tuple(
        Trace(f"t{k}", np.arange(n) * 0.01, np.zeros((n, 1)), np.zeros((n, 1))) for k, n in enumerate((250, 30, 1001))
    )
    record = Record(traces, ("q",), ("u",))
    windows = split_windows(record, 1.0)  # the second trace is shorter than half a window
    covered = np.concatenate([np.arange(a, b) for a, b in zip(windows.start, windows.stop, strict=True)])
    assert covered.tolist() == [*range(250), *range(280, 1281)]
    with pytest.raises(UserError, match=r"longest lasts 10 s"):
        split_windows(record, 100.0)
    held = confirm_mask([trace.name for trace in record.traces], windows, (), 0.25, 2)
    assert 0.15 < held.mean() < 0.4
    with pytest.raises(UserError, match="t0, t1, t2"):
        confirm_mask([trace.name for trace in record.traces], windows, ("elsewhere",), 0.25)


def test_sensitivities_agree_with_the_variational_equations():
    t = np.arange(0.0, 1.0, 0.005)
    u = np.sin(4.0 * t)
    problem, compiled = one_window(point_pendulum(1.0, 0.5, 1.0 / 3.0), t, u, measured=("angle",))
    theta = with_effect(compiled, "viscous_friction", "hinge", b=0.1)
    slot, x0 = compiled.find("viscous_friction", "hinge").slots[0], np.array([[0.5, 0.2]])
    step = choose_steps(replace(problem, sigma=np.array([1e-3])), theta, x0, [slot])[slot]
    linear = linearise(problem, theta, x0, [slot_direction(problem, theta, slot, step)])

    def slope(_: float, z: np.ndarray, torque: float) -> np.ndarray:  # the state, then columns for q0, v0, b
        q, v, s = z[0], z[1], z[2:].reshape(2, 3)
        jacobian = np.array([[0.0, 1.0], [-3.0 * 4.905 * np.cos(q), -0.3]])
        forcing = np.zeros((2, 3))
        forcing[1, 2] = -3.0 * v
        return np.concatenate([[v, 3.0 * (torque - 0.1 * v - 4.905 * np.sin(q))], (jacobian @ s + forcing).ravel()])

    z = np.concatenate([[0.5, 0.2], [1, 0, 0, 0, 1, 0]])
    rows = [z[2:5]]
    for k in range(len(t) - 1):
        z = solve_ivp(slope, (t[k], t[k + 1]), z, args=(u[k],), rtol=1e-10, atol=1e-12).y[:, -1]
        rows.append(z[2:5])
    columns = np.array(rows)
    q, _ = np.linalg.qr(columns[:, :2])
    projected = columns[:, 2] - q @ (q.T @ columns[:, 2])
    assert linear.gram[0, 0] == pytest.approx(float(projected @ projected), rel=1e-4)


def _slide(t, u, x0, mass, viscous):
    """SciPy's motion of a block, m a = u - b v, each command held over its interval -> (n, 2)."""
    rows = [np.asarray(x0)]
    for a, b, push in zip(t[:-1], t[1:], u[:-1], strict=True):
        go = solve_ivp(
            lambda _, x, push=push: [x[1], (push - viscous * x[1]) / mass], (a, b), rows[-1], "DOP853", rtol=1e-10,
            atol=1e-12,
        )  # fmt: skip
        rows.append(go.y[:, -1])
    return np.array(rows)


def _record(seed, mass=2.0, viscous=0.0, sigma=1e-3, seconds=10.0, traces=2):
    """Traces of a block that SciPy moved, with white noise on the position."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(traces):
        t = np.arange(0.0, seconds, 0.01)
        u = 3.0 * np.sin(np.outer(t, rng.uniform(1.0, 12.0, 5)) + rng.uniform(0, 6, 5)).mean(axis=1)
        x = _slide(t, u, rng.uniform(-0.3, 0.3, 2), mass, viscous)
        y = x[:, :1] + sigma * rng.standard_normal((len(t), 1))
        out.append(Trace(f"trace-{k}", t, y, u[:, None]))
    return Record(tuple(out), ("q",), ("u",))


def test_mass_and_gain_of_a_block_cannot_be_told_apart_and_it_says_so():
    d = diagnose(block(), _record(1, mass=2.5), DiagnosisSettings(max_effects=2))
    assert d.verdict == "attributed"
    (found,) = d.effects
    named = {(found.name, found.on), *(s[0] for s in found.alternatives)}
    assert {("parameter_error", "mass"), ("input_gain", "u")} <= named
    assert any(a.exact for a in d.alternatives)
    ratio = found.parameters["ratio"]
    expected = 1.25 if found.name == "parameter_error" else 0.8
    assert ratio.ci95[0] <= expected <= ratio.ci95[1]
    assert ratio.value == pytest.approx(expected, rel=0.005)


def test_an_equal_that_ends_in_a_better_optimum_is_an_equal():
    """Where a fit has several optima one of two equal sets may end in a worse one: the same model all the same."""
    parts = ready(block(), _record(2, mass=2.5), DiagnosisSettings(max_effects=1))[0].parts
    search, base = begun(parts.known, {}, Watch())
    found = select(search, base, 1)
    for above in (0.0, 400.0):
        worse = replace(found, fit=replace(found.fit, chi2=found.fit.chi2 + above), bic=found.bic + above)
        same = [r.explanation for r in rivals(search, worse) if r.exact]
        assert {("parameter_error", "mass"), ("input_gain", "u")} <= {k for e in same for k in e.keys} | found.keys


def test_the_corrected_model_predicts_at_the_floor():
    d = diagnose(block(), _record(2, viscous=0.5), DiagnosisSettings(max_effects=2))
    assert [(e.name, e.on) for e in d.effects] == [("viscous_friction", "slide")]
    assert d.applied[0].values["b"] == pytest.approx(0.5, rel=0.02)
    assert d.after.held_out_ratio < 1.08 < d.before.held_out_ratio
    assert d.after.horizon_rmse["q"] < 1.5 * d.floor.horizon_rmse["q"] < d.before.horizon_rmse["q"]
    assert d.folds["confirm"]


def test_a_model_that_lacks_nothing_is_told_so():
    d = diagnose(block(), _record(3), DiagnosisSettings(max_effects=1))
    assert (d.verdict, d.effects, d.applied) == ("none", (), ())


def test_refusals():
    record = _record(3, seconds=2.0, traces=1)
    with pytest.raises(UserError, match="inputs"):
        diagnose(block(), replace(record, inputs=("force",)))
    with pytest.raises(UserError, match="viscous_friction"):
        diagnose(block(), record, DiagnosisSettings(effects=("viscosity",)))
    with pytest.raises(UserError, match="not finite"):
        Trace("bad", np.array([0.0, np.nan]), np.zeros((2, 1)), np.zeros((2, 1)))
    with pytest.raises(UserError, match="backwards"):
        Trace("bad", np.array([0.0, 0.0]), np.zeros((2, 1)), np.zeros((2, 1)))
