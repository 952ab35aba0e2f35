"""Three folds: every window is of one, traces stay whole, short records say so, and *confirm* chooses nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import cut_in_folds, split_folds, split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.thresholds import FEWEST_WINDOWS
from simgap.errors import UserError
from tests.diagnosis.plants import block

DT, MASS = 0.01, 2.0
SETTINGS = DiagnosisSettings(horizon_s=0.0)


def _still(*seconds: float) -> Record:
    """Traces of a plant that does nothing."""
    counts = [round(s / DT) + 1 for s in seconds]
    zeros = [np.zeros((n, 1)) for n in counts]
    traces = (Trace(f"t{k}", np.arange(len(z)) * DT, z, z) for k, z in enumerate(zeros))
    return Record(tuple(traces), ("q",), ("u",))


def _names(record: Record, traces: tuple[str, ...] = (), share: float = 0.25) -> list[set[str]]:
    windows = split_windows(record, 1.0)
    folds = split_folds([trace.name for trace in record.traces], windows, traces, share)
    return [{record.traces[k].name for k in windows.trace[mask]} for mask in (folds.fit, folds.choose, folds.confirm)]


@pytest.mark.parametrize("seconds", [(3.0,), (7.0,), (30.0,), (15.0, 15.0), (4.0, 9.0), (5.0,) * 3, (2.0,) * 9])
@pytest.mark.parametrize("block_", [1, 3])
def test_every_window_is_of_one_fold(seconds, block_):
    record = _still(*seconds)
    windows = split_windows(record, 1.0)
    folds = split_folds([trace.name for trace in record.traces], windows, (), 0.25, block_)
    assert folds.complete
    assert (folds.fit.astype(int) + folds.choose + folds.confirm).tolist() == [1] * len(windows)
    if len(seconds) == 1 and seconds[0] == 30.0:
        assert 0.2 <= folds.choose.mean() <= 0.3
        assert 0.2 <= folds.confirm.mean() <= 0.3
        where = np.flatnonzero(folds.choose)
        assert np.ptp(where) >= 15  # spread over the record
        assert np.all(np.diff(np.flatnonzero(np.diff(folds.choose.astype(int)))) >= block_)


def test_traces_stay_whole_where_there_are_several():
    for record in (_still(5, 5, 5), _still(9, 3, 4, 5), _still(*[2.0] * 9)):
        fit, choose, confirm = _names(record)
        assert not fit & choose
        assert not (fit | choose) & confirm
    fit, choose, confirm = _names(_still(4, 4, 4, 4), ("t0", "t1"))
    assert (fit, choose, confirm) == ({"t2"}, {"t3"}, {"t0", "t1"})
    fit, choose, confirm = _names(_still(4, 4), ("t0",))
    assert (fit, choose, confirm) == ({"t1"}, {"t1"}, {"t0"})


def test_a_short_record_is_cut_finer_or_refused():
    windows, folds, length = cut_in_folds(_still(1.0), SETTINGS, 1.0)
    assert folds.complete
    assert length < 1.0
    assert len(windows) >= 3
    told = replace(SETTINGS, held_out_traces=("t1",))
    _, folds, length = cut_in_folds(_still(1.0, 6.0), told, 1.0)  # one window is left for two folds
    assert folds.complete
    assert length == 0.25
    assert np.count_nonzero(~folds.confirm) == FEWEST_WINDOWS
    with pytest.raises(UserError, match="too few for the three folds"):
        cut_in_folds(_still(0.1), replace(SETTINGS, window_s=0.1), 0.1)


def _slid(viscous: float, dry: float, seed: int, seconds: float = 8.0) -> Trace:
    """A mass under a force, small Euler steps; what nothing in the model or the library tells comes on top."""
    rng = np.random.default_rng(seed)
    t, fine = np.arange(0.0, seconds, DT), 20
    waves = zip(rng.uniform(0.5, 1.5, 3), (0.4, 0.9, 1.7), rng.uniform(0, 6, 3), strict=True)
    u = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves)
    q, v, out = 0.0, 0.3, []
    for k, now in enumerate(t):
        out.append(q)
        for i in range(fine):
            extra = 0.12 * np.sin(2 * np.pi * 3.1 * (now + i * DT / fine))
            v += DT / fine * (u[k] + extra - viscous * v - dry * np.tanh(v / 1e-3)) / MASS
            q += DT / fine * v
    return Trace(f"run{seed}", t, np.array(out)[:, None] + 1e-4 * rng.standard_normal((len(t), 1)), u[:, None])


def test_what_confirms_chooses_nothing():
    """Judged on other plants, no other set is named: what confirms may refuse an answer and not change it."""
    settings = DiagnosisSettings(
        noise={"q": 1e-4}, effects=("viscous_friction", "coulomb_friction"), max_effects=1, held_out_traces=("run9",)
    )
    known = tuple(_slid(0.45, 0.17, seed) for seed in (1, 2, 3))
    same, viscous = (
        diagnose(block(), Record((*known, _slid(*plant, 9)), ("q",), ("u",)), settings)
        for plant in ((0.45, 0.17), (0.8, 0.0))
    )
    assert [e.name for e in same.effects] == ["coulomb_friction"]
    assert same.verdict == "partial"
    assert [e.name for e in viscous.effects] in ([], ["coulomb_friction"])  # viscous friction is nearer, and not chosen
    assert viscous.candidates == same.candidates
    assert {t for t, _, _ in same.folds["confirm"]} == {"run9"}
    assert {t for t, _, _ in same.folds["choose"]} == {"run3"}


def test_a_confirmation_that_fails_is_no_attribution():
    """Data down to the noise on fit and choose alone do not make a verdict."""
    settings = DiagnosisSettings(noise={"q": 1e-4}, effects=("viscous_friction",), held_out_traces=("run9",))
    t, u = np.arange(0.0, 6.0, DT), np.zeros(600)
    still = [Trace(f"a{k}", t, 1e-4 * np.random.default_rng(k).standard_normal((600, 1)), u[:, None]) for k in (1, 2)]
    confirm = _slid(0.8, 0.0, 9, 6.0)
    d = diagnose(block(), Record((*still, confirm), ("q",), ("u",)), settings)
    assert d.after.chi2_dof < 1.15
    assert d.after.held_out_ratio > 2.0
    assert d.verdict == "unexplained"


def test_a_share_that_leaves_nothing_to_fit_is_refused():
    with pytest.raises(UserError, match="leaves nothing to fit"):
        cut_in_folds(Record((_slid(0.4, 0.1, 1, 8.0),), ("q",), ("u",)), replace(SETTINGS, held_out_share=0.95), 1.0)
