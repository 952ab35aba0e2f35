"""An encoder's step: found in a file with few decimals too, and the floor of a perfect model is never below it."""

from __future__ import annotations

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.noise import resolution
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from tests.diagnosis.plants import block

DT, COUNT = 0.01, 2.44140625e-5


def _rests_and_moves(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A mass of 2 that stands for half of the time and slides between: exact for a force that is held."""
    rng = np.random.default_rng(seed)
    u = np.zeros(600)
    for k in (40, 240, 440):
        size = rng.uniform(0.5, 1.0)
        u[k : k + 40], u[k + 40 : k + 80] = size, -size  # off and back to rest
    q, v, out = 0.1 * rng.uniform(), 0.0, []
    for force in u:
        out.append(q)
        q += v * DT + 0.25 * force * DT**2
        v += 0.5 * force * DT
    return np.array(out), u


def _encoder(decimals: int | None) -> Record:
    traces = []
    for seed in (1, 2, 3):
        q, u = _rests_and_moves(seed)
        read = np.floor(q / COUNT) * COUNT
        read = read if decimals is None else np.round(read, decimals)
        traces.append(Trace(f"run{seed}", np.arange(len(q)) * DT, read[:, None], u[:, None]))
    return Record(tuple(traces), ("q",), ("u",))


@pytest.mark.parametrize(("decimals", "within"), [(None, 1e-9), (6, 0.03), (7, 0.003)])
def test_the_step_is_found_whatever_decimals_a_file_keeps(decimals, within):
    assert resolution(_encoder(decimals))[0] == pytest.approx(COUNT, rel=within)


def test_what_is_continuous_has_no_step():
    rng = np.random.default_rng(5)
    t = np.arange(3000) * DT
    for noise in (1e-6, 1e-3):
        y = np.sin(t) + noise * rng.standard_normal(3000)
        assert resolution(Record((Trace("a", t, y[:, None], 0 * y[:, None]),), ("q",), ("u",)))[0] == 0.0


def test_a_perfect_model_is_not_told_to_be_better_than_its_encoder():
    """Where nothing moves, neighbours are equal, and an estimate of the noise alone sees none."""
    d = diagnose(block(), _encoder(6), DiagnosisSettings(effects=("viscous_friction",)))
    assert d.sigma["q"] >= COUNT / np.sqrt(12) * 0.97
    assert d.floor.horizon_rmse["q"] >= d.sigma["q"]
    assert d.floor.fit_rmse["q"] >= d.sigma["q"]
