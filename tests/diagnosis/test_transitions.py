"""Transitions of a command that is held: velocities from positions, neighbouring windows, commands that change."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.config.load import parse_case
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.transitions import held, known_states, transitions, within
from simgap.plants.plant_model import PlantModel
from tests.stages import diagnosis_example as example

RATE, STEPS = 100.0, 50


@pytest.fixture(scope="module")
def model():
    return PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path()).corrected


def moved(x, u, seconds):
    """The bench by 400 midpoint steps under a held torque, written out by hand."""
    h = seconds / 400

    def rate(s):
        return np.array([s[1], (u - example.WEIGHT * np.sin(s[0])) / example.INERTIA])

    for _ in range(400):
        x = x + h * rate(x + 0.5 * h * rate(x))
    return x


def recorded(commands, sigma=0.0, seed=0):
    """A window of the frictionless bench: a command a sample, the angle with noise, both states."""
    x, states = np.array([0.3, 0.0]), []
    for u in commands:
        states.append(x)
        x = moved(x, u, 1.0 / RATE)
    states = np.array(states)
    q = states[:, :1] + sigma * np.random.default_rng(seed).standard_normal((len(states), 1))
    t = np.arange(len(states)) / RATE
    return WindowPrediction("bench", True, t, q, q, q, states, np.asarray(commands)[:, None])


def cut(window, length):
    """The same as short windows, one after another."""
    for a in range(0, len(window.t), length):
        s = slice(a, a + length)
        rows = (window.t, window.measured, window.before, window.after, window.states, window.inputs)
        yield WindowPrediction(window.trace, True, *(r[s] for r in rows))


def test_a_velocity_that_was_not_measured_is_had_from_its_position(model):
    t = np.arange(600) / RATE
    whole = recorded(np.sin(5.0 * t), sigma=1e-4)
    found = transitions(list(cut(whole, 60)), {"q": 1e-4}, model, 0.05, 0.95)
    assert known_states(model, ["q"]) == ["q", "v"]
    assert len(found.at) == 119 - 2 * 6  # neighbours are one window, whose 119 steps are six stretches
    true = np.stack([np.interp(found.at, whole.t, x) for x in whole.states.T], axis=1)
    error = np.std(found.start[:, :2] - true, axis=0)
    assert error[0] < 1e-4
    assert error[1] < 1e-4 / 0.05
    assert np.all(np.abs(found.missed).max(axis=0) <= 4.0 * found.spread.max(axis=0) + 1e-6)


def test_windows_with_a_gap_between_them_stay_apart(model):
    parts = list(cut(recorded(np.zeros(200)), 50))
    found = transitions([parts[0], parts[1], parts[3]], {"q": 1e-4}, model, 0.1, 0.95)
    assert len(found.at) == 7 + 2
    assert set(np.round(found.at, 6)) == {*np.round(np.arange(1, 8) / 10, 6), 1.6, 1.7}


def test_commands_that_change_within_a_step_count_as_held_at_their_mean(model):
    """A command that rises by 2 N m in a step of eight samples moves the angle otherwise than its mean does."""
    window = recorded(np.tile(np.linspace(-1.0, 1.0, 8), 12), sigma=1e-7)
    found = transitions([window], {"q": 1e-7}, model, 8 / RATE, 0.95)
    assert found.start[:, 2] == pytest.approx(0.0, abs=1e-12)
    end = held(model, found)
    for start, there in zip(found.start, end, strict=True):
        assert there == pytest.approx(moved(start[:2], start[2], 8 / RATE), abs=2e-5)
    plain = window.states[8] - moved(window.states[0], 0.0, 8 / RATE)
    assert abs(plain[0]) > 1e-3  # what the change alone does
    assert np.abs(found.missed[:, 0]).max() < 1e-4  # and what is missed does not hold it


def test_a_reading_that_is_no_measurement_is_not_heard(model):
    whole = recorded(np.sin(np.arange(200) / 9.0), sigma=1e-4)
    spoilt = whole.measured.copy()
    spoilt[77] += 0.5
    used = np.ones_like(spoilt)
    used[77] = 0.0
    clean, marked = (
        transitions([replace(whole, measured=m, used=used)], {"q": 1e-4}, model, 0.05, 0.95)
        for m in (whole.measured, spoilt)
    )
    assert clean.missed == pytest.approx(marked.missed, abs=1e-12)


def test_only_transitions_that_begin_in_X_count(model):
    window = recorded(np.sin(np.arange(400) / 20.0), sigma=1e-4)
    found = transitions([window], {"q": 1e-4}, model, 0.05, 0.95)
    inside = within(found, model, {"q": (-0.1, 0.1)}, held_out=True)
    assert 0 < len(inside.start) < len(found.start)
    assert np.all(np.abs(inside.start[:, 0]) <= 0.1)
    assert len(inside.missed) == len(inside.start)
    assert not len(within(found, model, {}, held_out=False).start)
