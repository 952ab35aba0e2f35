"""Rows that are missing, a sensor at its limit, few readings, fast sampling: each told for what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.faults.registry import READINGS, mended
from simgap.diagnosis.record.folds import Windows, split_windows
from simgap.diagnosis.record.noise import noise_floor
from simgap.diagnosis.record.record import Record, Trace, runs
from simgap.diagnosis.record.survey import survey
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.confidence import at_noise
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import Hypothesis, no_louder_than_misses
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.verdict.held_out import horizon_error
from tests.diagnosis import rigs
from tests.diagnosis.plants import block


def _repaired(made: Record):
    return mended(made, rigs.oscillator_model(), READINGS)


def _without_rows(made: Record, share: float, seed: int) -> Record:
    """The record without some of its rows, evenly at random."""
    rng, traces = np.random.default_rng(seed), []
    for trace in made.traces:
        keep = rng.random(len(trace.t)) >= share
        keep[[0, -1]] = True
        traces.append(Trace(trace.name, trace.t[keep], trace.y[keep].copy(), trace.u[keep].copy()))
    return replace(made, traces=tuple(traces))


def test_rows_that_are_missing_are_told_and_buy_no_effect():
    rig = replace(rigs.oscillator(), rate=100.0)
    d = diagnose(rig.model, _without_rows(rigs.record(rig, "clean", 8211), 0.02, 5))
    assert (d.verdict, d.effects) == ("none", ())
    (fault,) = d.recording
    assert fault.fault == "missing_rows"
    assert 0.01 < fault.value < 0.03


def test_a_missing_row_lies_between_its_neighbours_and_is_not_compared():
    t = np.delete(np.arange(200) / 100.0, [40, 41, 90])
    u = np.sin(t)
    y = np.cos(t) + 1e-3 * np.random.default_rng(6).standard_normal(t.size)
    made, (fault,) = _repaired(Record((Trace("a", t, y[:, None], u[:, None]),), ("q",), ("u",)))
    trace = made.traces[0]
    assert np.allclose(trace.t, np.arange(200) / 100.0)
    assert np.flatnonzero(trace.compared[:, 0] == 0.0).tolist() == [40, 41, 90]
    assert np.abs(trace.u[:, 0] - np.sin(trace.t)).max() < 1e-4
    assert fault.fault == "missing_rows"


def test_stamps_that_jitter_miss_no_row():
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(0.005, 0.02, 300))
    y = np.cos(t) + 1e-3 * rng.standard_normal(t.size)
    made, faults = _repaired(Record((Trace("a", t, y[:, None], y[:, None]),), ("q",), ("u",)))
    assert faults == ()
    assert np.array_equal(made.traces[0].t, t)


def test_a_sensor_at_its_limit_is_no_stale_one():
    rig = rigs.oscillator()
    made = rigs.record(rig, "clean", 8212)
    top = float(np.quantile(np.concatenate([trace.y[:, 0] for trace in made.traces]), 0.98))
    cut = replace(made, traces=tuple(replace(trace, y=np.minimum(trace.y, top)) for trace in made.traces))
    fixed, faults = _repaired(cut)
    assert [f.fault for f in faults] == ["saturated_reading"]
    for before, after in zip(cut.traces, fixed.traces, strict=True):
        held = np.convolve(before.y[:, 0] == top, np.ones(3), "same") >= 3  # the middle of three at the limit
        assert not after.compared[held].any()


def test_the_limit_of_what_is_noise_knows_how_few_readings_there_are():
    """RMSE/sigma of 1.10 is one draw in a hundred of 160 readings, and none of 10^6 of 16,000."""
    assert at_noise(1.10**2 * 160, 160)
    assert not at_noise(1.10**2 * 16_000, 16_000)
    draws = np.random.default_rng(8).chisquare(160, 20_000)
    assert np.mean([at_noise(float(x), 160) for x in draws[:2000]]) > 0.997


def test_errors_ahead_are_told_of_a_plant_that_is_read_50000_times_a_second():
    model = cached_supermodel(block(), ("q",))
    t = np.arange(2000) / 50_000.0
    record = Record((Trace("a", t, np.zeros((2000, 1)), np.zeros((2000, 1))),), ("q",), ("u",))
    start = np.arange(0, 2000, 100, dtype=np.int64)
    windows = Windows(start, start + 100, np.zeros(20, dtype=np.int64))
    ahead = horizon_error(build_problem(model, record, windows, np.array([1e-3])), model.null, 0.001)
    assert ahead is not None
    assert len(ahead.error) > 20


@pytest.mark.parametrize("lost", [0.0, 0.5])
def test_a_prediction_that_ends_where_nothing_was_read_is_no_prediction(lost):
    """A block at rest misses by the noise that is expected of it, whether or not half of the readings are lost."""
    model = cached_supermodel(block(), ("q",))
    t, rng = np.arange(4000) / 100.0, np.random.default_rng(12)
    used = (rng.random((4000, 1)) >= lost).astype(float)
    record = Record((Trace("a", t, 1e-3 * rng.standard_normal((4000, 1)), np.zeros((4000, 1)), used),), ("q",), ("u",))
    start = np.arange(0, 4000, 100, dtype=np.int64)
    windows = Windows(start, start + 100, np.zeros(40, dtype=np.int64))
    found = horizon_error(build_problem(model, record, windows, np.array([1e-3])), model.null, 0.2)
    assert found is not None
    assert len(found.error) > 500
    assert float(found.rmse[0]) == pytest.approx(float(found.floor[0]), rel=0.15)


@pytest.mark.parametrize("lost", [0.0, 0.5])
def test_a_noise_taken_for_too_large_becomes_that_of_the_readings_that_are_left(lost):
    """A block at rest, its noise taken for three times what it is."""
    t, rng = np.arange(4000) / 100.0, np.random.default_rng(13)
    used = (rng.random((4000, 1)) >= lost).astype(float)
    record = Record((Trace("a", t, 1e-3 * rng.standard_normal((4000, 1)), np.zeros((4000, 1)), used),), ("q",), ("u",))
    start = np.arange(0, 4000, 100, dtype=np.int64)
    windows = Windows(start, start + 100, np.zeros(40, dtype=np.int64))
    problem = build_problem(cached_supermodel(block(), ("q",)), record, windows, np.array([3e-3]))
    parts = Parts(problem, problem, problem, problem, 1.0, 0.5)
    start = Hypothesis.of(parts, DiagnosisSettings(max_effects=0), {}, Watch())
    quieter = no_louder_than_misses(start, np.zeros(1)).parts
    assert float(quieter.known.sigma[0]) == pytest.approx(1e-3, rel=0.05)


def _swinging(rate: float = 200.0, seconds: float = 20.0, seed: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and readings of a motion of 150 mm with noise of 0.3 mm."""
    t = np.arange(round(seconds * rate)) / rate
    x = 0.075 * np.sin(2 * np.pi * 0.35 * t) + 0.01 * np.sin(2 * np.pi * 1.7 * t + 1.0)
    return t, x + 3e-4 * np.random.default_rng(seed).standard_normal(t.size)


def _of(t: np.ndarray, y: np.ndarray) -> Record:
    return Record((Trace("a", t, y[:, None], np.zeros((t.size, 1))),), ("q",), ("force",))


def test_readings_that_jump_away_for_a_few_samples_do_not_raise_the_noise():
    t, y = _swinging()
    for begin, lasts, value in ((300, 1, 0.3), (900, 2, -0.3), (1500, 5, 0.0), (2700, 2, 0.5)):
        y[begin : begin + lasts] = value
    made, (fault,) = _repaired(_of(t, y))
    assert fault.fault == "spikes"
    assert fault.value * t.size == pytest.approx(10, abs=1)
    assert noise_floor(made)[0] == pytest.approx(3e-4, rel=0.05)


def test_what_overflows_is_given_its_range_back():
    t, true = _swinging(seed=41)
    low, high = np.quantile(true, [0.04, 0.97])
    made, (fault,) = _repaired(_of(t, (true - low) % (high - low) + low))
    assert (fault.fault, fault.unit) == ("overflow", "m")
    assert fault.value == pytest.approx(high - low, rel=0.01)
    assert np.abs(made.traces[0].y[:, 0] - true).max() < 2e-3
    assert made.traces[0].compared.all()


def test_an_encoder_at_its_limit_does_not_flicker():
    t, true = _swinging(seed=42)
    step = 5e-4
    y = np.round(true / step) * step
    cut = np.minimum(y, np.round(0.93 * y.max() / step) * step)
    held = cut == cut.max()
    assert _repaired(_of(t, y))[1] == ()
    made, (fault,) = _repaired(_of(t, cut))
    assert fault.fault == "saturated_reading"
    assert made.traces[0].compared[held, 0].mean() < 0.1


def test_an_encoder_that_rests_at_its_ends_is_not_saturated():
    t = np.arange(4000) / 200.0
    moved = 0.05 * np.clip(1.3 * np.sin(2 * np.pi * 0.4 * t), -1.0, 1.0)
    assert _repaired(_of(t, np.round(moved / 5e-4) * 5e-4))[1] == ()


def test_a_shaft_that_friction_stops_at_its_farthest_is_not_saturated():
    """It stays longest at the ends of its way; stamps jitter, so that its counts flicker in motion, and then not."""
    rng, (x, v), way = np.random.default_rng(46), (0.0, 0.0), []
    pushes = ((2.0, 200), (0.0, 350), (-3.0, 260), (0.0, 700), (2.5, 180), (0.0, 330), (-1.5, 90), (0.0, 100))
    for torque, samples in pushes:
        for _ in range(4 * samples):
            rubs = 1.0 if v > 0.0 else -1.0 if v < 0.0 else float(np.clip(torque, -1.0, 1.0))
            faster = v + (torque - rubs) / 800.0
            v = 0.0 if v * faster < 0.0 and abs(torque) <= 1.0 else faster
            x += v / 800.0
            way.append(x)
    t = np.arange(len(way) // 4) / 200.0
    late = np.clip(t + rng.uniform(-2e-3, 2e-3, t.size), 0.0, None)
    counts = np.round(np.interp(late, np.arange(len(way)) / 800.0, way) / 2e-3) * 2e-3
    assert max(b - a for a, b in runs(counts == counts.min())) > 100
    assert _repaired(_of(t, counts))[1] == ()


def test_rows_are_missed_under_jittering_stamps_too():
    rng, (t, y) = np.random.default_rng(43), _swinging()
    keep = rng.random(t.size) > 0.02
    keep[[0, -1]] = True
    stamps = t[keep] + 4e-4 * rng.standard_normal(int(keep.sum()))
    made, (fault,) = _repaired(_of(stamps, y[keep]))
    assert fault.fault == "missing_rows"
    assert made.rows == t.size


def test_no_window_holds_inputs_that_nobody_knows():
    t, y = _swinging()
    u = np.sin(2 * np.pi * 8.0 * t)
    keep = np.ones(t.size, dtype=bool)
    keep[1010:1015] = keep[2000] = False
    record = Record((Trace("a", t[keep], y[keep, None], u[keep, None]),), ("q",), ("force",))
    made, _ = _repaired(record)
    windows = split_windows(made, 1.0)
    inside = np.zeros(t.size, dtype=bool)
    for a, b in zip(windows.start, windows.stop, strict=True):
        inside[a:b] = True
    assert not inside[1010:1015].any()  # more than half a period of the input
    assert inside[1995:2005].all()  # one row: the line between its neighbours tells it


def test_rest_is_told_by_clean_readings():
    """Spikes had made all of a swing of 150 mm seem to be within the noise."""
    t, y = _swinging(seed=44)
    y[np.random.default_rng(45).integers(10, t.size - 10, 40)] += 0.5
    look = survey(_of(t, y), rigs.oscillator_model())
    assert look.still == ()
    assert look.channels[0].noise == pytest.approx(3e-4, rel=0.1)


def test_a_motion_that_is_back_after_a_few_slow_readings_is_no_spike():
    """A motor of the go1 records lifts and drops within three readings at 25 Hz, and rests else."""
    t = np.arange(400) / 25.0
    y = 1e-3 * np.random.default_rng(46).standard_normal(400)
    for begin in (60, 170, 290):
        y[begin : begin + 3] += 0.5
    assert _repaired(_of(t, y))[1] == ()
