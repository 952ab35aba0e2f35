"""What readings of an encoder are worth, against errors drawn by the definition of rounding; and a whole diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.noise import worth
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from tests.undeclared.counted import counted_model, counted_record

STEP, REST, MOVE = 1e-3, 200, 40


def _record(place: np.ndarray, white: float, seed: int = 0) -> Record:
    """Readings of places (n,) in counts by an encoder, white noise before the rounding; its zero is no whole count."""
    noise = white * np.random.default_rng(seed).standard_normal(len(place))
    y = STEP * (0.37 + np.round(place + noise))
    t = 0.005 * np.arange(len(place))
    return Record((Trace("run", t, y[:, None], np.zeros((len(place), 1))),), ("q",), ("u",))


def _rests(seed: int, count: int = 40) -> np.ndarray:
    """Moves of some counts a reading, and rests at places anywhere within a count."""
    out, at, rng = [], 0.0, np.random.default_rng([seed, 1])
    for _ in range(count):
        to = rng.uniform(80.0, 200.0)
        s = np.linspace(0.0, 1.0, MOVE)
        out += [at + (to - at) * s * s * (3.0 - 2.0 * s), np.full(REST, to)]
        at = to
    return np.concatenate(out)


@pytest.mark.parametrize("white", [0.0, 0.1, 0.2, 1.0])
def test_noise_is_the_rounding_and_what_was_before_it(white):
    found = worth(_record(_rests(1, 400), white, 1)).sigma[0]
    assert found == pytest.approx(STEP * np.sqrt(1 / 12 + white**2), rel=0.06)


@pytest.mark.parametrize("white", [0.02, 0.1, 0.2])
def test_readings_at_rest_are_worth_what_their_mean_tells(white):
    """The mean of n readings at a place scatters, over places and noise, as one of variance sigma^2 / (n weight)."""
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 1.0, 4000)
    mean = np.mean(np.round(places[:, None] + white * rng.standard_normal((4000, REST))), axis=1)
    wanted = float(np.mean((mean - places) ** 2))
    weight = worth(_record(_rests(2, 400), white, 2)).weight[:, 0].reshape(-1, MOVE + REST)[:, MOVE + 10 : -10]
    got = (1 / 12 + white**2) / (REST * np.mean(weight))
    assert 0.7 < got / wanted < 1.4


def test_fast_motion_and_dithered_readings_are_worth_one_each():
    swing = 3000.0 * np.sin(0.01 * np.arange(2000))
    fast = np.abs(np.cos(0.01 * np.arange(2000))) > 0.2
    assert np.all(worth(_record(swing, 0.0)).weight[fast, 0] > 0.9)
    assert worth(_record(_rests(4), 0.7)).weight.min() > 0.9
    smooth = np.random.default_rng(1).standard_normal((50, 1))
    assert np.all(worth(Record((Trace("run", np.arange(50.0), smooth, smooth),), ("q",), ("u",))).weight == 1.0)


def test_ten_readings_a_count_are_worth_one():
    slow = np.concatenate([_rests(5), 80.0 + 0.1 * np.arange(2000)])
    assert worth(_record(slow, 0.0)).weight[-1500:-500, 0] == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(("plant", "hidden", "noises"), [("motor", "both", 50.0), ("ball", "nothing", 50.0)])
def test_a_coarse_encoder_does_not_decide_the_verdict(plant, hidden, noises):
    """Hundredths of a radian and millimetres: rounding is most of what the model leaves, and the same at rest."""
    record, truth = counted_record(plant, hidden, noises * {"motor": 2e-4, "ball": 2e-5}[plant], 2, rate=200.0)
    d = diagnose(counted_model(plant), record, DiagnosisSettings())
    assert d.verdict == ("attributed" if truth else "none")
    assert {(e.name, e.on): set(e.parameters) for e in d.effects} == {k: set(v) for k, v in truth.items()}
    assert d.recording == ()
    for e in d.effects:
        for symbol, true in truth[(e.name, e.on)].items():
            assert e.parameters[symbol].ci95[0] <= true <= e.parameters[symbol].ci95[1]
