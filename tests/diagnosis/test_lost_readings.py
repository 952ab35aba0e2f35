"""Rows that are missing, a sensor at its limit, few readings, fast sampling: each told for what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.faults.readings import repaired
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.search.confidence import at_noise
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.verdict.horizon import horizon_error
from tests.diagnosis import rigs
from tests.diagnosis.plants import block


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
    made, (fault,) = repaired(Record((Trace("a", t, y[:, None], u[:, None]),), ("q",), ("u",)))
    trace = made.traces[0]
    assert np.allclose(trace.t, np.arange(200) / 100.0)
    assert np.flatnonzero(trace.compared[:, 0] == 0.0).tolist() == [40, 41, 90]
    assert np.abs(trace.u[:, 0] - np.sin(trace.t)).max() < 1e-4
    assert fault.fault == "missing_rows"


def test_stamps_that_jitter_miss_no_row():
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(0.005, 0.02, 300))
    y = np.cos(t) + 1e-3 * rng.standard_normal(t.size)
    made, faults = repaired(Record((Trace("a", t, y[:, None], y[:, None]),), ("q",), ("u",)))
    assert faults == ()
    assert np.array_equal(made.traces[0].t, t)


def test_a_sensor_at_its_limit_is_no_stale_one():
    rig = rigs.oscillator()
    made = rigs.record(rig, "clean", 8212)
    top = float(np.quantile(np.concatenate([trace.y[:, 0] for trace in made.traces]), 0.98))
    cut = replace(made, traces=tuple(replace(trace, y=np.minimum(trace.y, top)) for trace in made.traces))
    fixed, faults = repaired(cut)
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
    windows = Windows(start, start + 100, np.zeros(20, dtype=np.int64), np.zeros(20, dtype=np.int64))
    ahead = horizon_error(build_problem(model, record, windows, np.array([1e-3])), model.null, 0.001)
    assert ahead is not None
    assert len(ahead.error) > 20
