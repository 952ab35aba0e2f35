"""The look at the data sees what was put into it, and says what to do."""

import re

import numpy as np
import pytest
import sympy as sp

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.record.survey import survey
from simgap.model.symbolic import Coordinate, SymbolicModel, Variable, symbol

MODEL = SymbolicModel(
    states=(Variable("q", "rad"), Variable("v", "rad/s")),
    inputs=(Variable("u", "N*m"),),
    parameters={},
    xdot=(symbol("v"), symbol("u") - 10 * sp.sin(symbol("q"))),
    coordinates=(Coordinate("hinge", "q", "v"),),
    force_map={"hinge": (sp.Integer(0), sp.Integer(1))},
)
SIGMA = 1e-3


def motion(seed=0, size=2.0, seconds=12.0, rate=200.0):
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    q = size * np.sin(2.3 * t) + 0.2 * size * np.sin(5.1 * t + 1)
    v = 2.3 * size * np.cos(2.3 * t) + 5.1 * 0.2 * size * np.cos(5.1 * t + 1)
    u = np.sin(3 * t) + 0.5 * np.sin(11 * t)
    return t, q + SIGMA * rng.standard_normal(t.size), v + 10 * SIGMA * rng.standard_normal(t.size), u


def look(t, q, v, u):
    columns = np.stack([q, v], axis=1) if v is not None else q[:, None]
    measured = ("q", "v") if v is not None else ("q",)
    return survey(Record((Trace("run", t, columns, u[:, None]),), measured, ("u",)), MODEL)


def test_good_data_raise_no_warning():
    seen = look(*motion())
    assert seen.warnings == ()
    (trace,) = seen.traces
    assert trace.rate_hz == pytest.approx(200.0)
    assert trace.jitter_s < 1e-12
    q, v, _ = seen.channels
    assert q.noise == pytest.approx(SIGMA, rel=0.1)
    assert v.noise == pytest.approx(10 * SIGMA, rel=0.1)
    assert q.resolution == 0.0
    assert abs(seen.lags[0].lag_s) < 5e-4
    assert seen.lags[0].scale == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("lag", [0.0137, -0.008])
def test_the_lag_of_a_velocity_channel(lag):
    t, q, v, u = motion()
    late = np.interp(t - lag, t, v)
    seen = look(t, q, late, u)
    assert seen.lags[0].lag_s == pytest.approx(lag, abs=5e-4)
    assert any(("trails" if lag > 0 else "leads") in w for w in seen.warnings)


def test_a_velocity_in_the_wrong_unit_or_of_something_else():
    t, q, v, u = motion()
    (warned,) = look(t, q, np.degrees(v), u).warnings
    found = re.match(r"v is ([\d.]+) times the derivative of q: check the units", warned)
    assert found, warned
    assert float(found[1]) == pytest.approx(180 / np.pi, rel=2e-3)
    assert any("not the derivative" in w for w in look(t, q, np.random.default_rng(3).permutation(v), u).warnings)


def test_excitation_that_says_too_little():
    t, q, v, u = motion(size=0.2)
    assert any("of its middle" in w for w in look(t, q, v, u).warnings)
    t, q, v, u = motion()
    (held,) = [w for w in look(t, q, v, np.full_like(u, 0.7)).warnings if "input u is constant" in w]
    assert "delay and lag cannot be identified" in held
    assert "a step in the first row hides" in held
    one_way = look(t, 3.0 * t + 0.1 * np.sin(t), None, u)
    assert any("one direction only" in w for w in one_way.warnings)


def test_an_input_at_its_limit():
    t, q, v, u = motion()
    seen = look(t, q, v, np.clip(u, -1.0, 1.0))
    assert seen.channels[-1].at_limit == pytest.approx(np.mean(np.abs(u) >= 1.0), abs=0.01)
    assert any("sits at its extreme" in w for w in seen.warnings)
    assert look(t, q, v, np.sign(u)).channels[-1].at_limit == 0.0  # bang-bang has no limit to speak of


def test_what_its_noise_hides_is_not_said_to_rest():
    """A speed that is read in few counts a second, noise as large as a fifth of its way."""
    t, q, v, u = motion()
    noisy = np.random.default_rng(6).normal(0.0, 0.2 * np.ptp(q), t.size)
    seen = look(t, q + noisy, v + 0.2 * np.ptp(v) * noisy / np.std(noisy), u)
    assert not seen.still
    assert not any("no reading changes by more" in w for w in seen.warnings)


def test_a_stuck_tail_and_a_hanging_sensor():
    t, q, v, u = motion()
    rng = np.random.default_rng(5)
    stop = t > 7.0
    rest = look(
        t,
        np.where(stop, 0.5 + SIGMA * rng.standard_normal(t.size), q),
        np.where(stop, 10 * SIGMA * rng.standard_normal(t.size), v),
        u,
    )
    assert sum(s.seconds for s in rest.still) == pytest.approx(5.0, abs=0.5)
    assert any("no reading changes by more" in w for w in rest.warnings)
    hung = np.where((t > 4.0) & (t < 5.0), q[800], q)
    seen = look(t, hung, v, u)
    assert [s.channel for s in seen.frozen] == ["q"]
    assert seen.frozen[0].seconds == pytest.approx(1.0, abs=0.02)


def test_the_resolution_of_an_encoder():
    t, q, v, u = motion()
    step = 2 * np.pi / 4096
    assert look(t, step * np.round(q / step), v, u).channels[0].resolution == pytest.approx(step, rel=1e-6)


def test_slow_motion_says_nothing_of_a_lag():
    """A heading that turns in half a minute, read twenty times a second with noise: no shift does better."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 110.0, 0.05)
    q, v = np.sin(0.2 * t) + 5e-3 * rng.standard_normal(t.size), 0.2 * np.cos(0.2 * t)
    seen = look(t, q, v + 0.05 * rng.standard_normal(t.size), np.sin(0.2 * t))
    assert seen.lags[0].lag_s == 0.0
    assert not [w for w in seen.warnings if "trails" in w or "leads" in w]
