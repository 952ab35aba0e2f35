"""Transitions of a command that is held: velocities from positions, neighbouring windows, commands that change."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.config.load import parse_case
from simgap.correction.transitions import seen, transitions, within
from simgap.diagnosis.result import WindowPrediction
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
    return WindowPrediction("bench", True, t, q, q, q, states, np.asarray(commands)[:, None], np.ones_like(q))


def cut(window, length):
    """The same as short windows, one after another."""
    for a in range(0, len(window.t), length):
        s = slice(a, a + length)
        rows = (window.t, window.measured, window.before, window.after, window.states, window.inputs, window.used)
        yield WindowPrediction(window.trace, True, *(r[s] for r in rows))


def test_a_velocity_that_was_not_measured_is_had_from_its_position(model):
    t = np.arange(600) / RATE
    whole = recorded(np.sin(5.0 * t), sigma=1e-4)
    (one,), sigma = seen(list(cut(whole, 60)), {"q": 1e-4}, model)
    assert list(sigma) == ["q", "v"]
    true = np.interp(one.t, whole.t, whole.states[:, 1])
    error = one.measured[:, 1] - true
    assert np.std(error) == pytest.approx(sigma["v"], rel=0.3)
    assert abs(np.mean(error)) < 0.1 * sigma["v"]


def test_windows_with_a_gap_between_them_stay_apart(model):
    whole = recorded(np.zeros(200))
    parts = list(cut(whole, 50))
    apart, _ = seen([parts[0], parts[1], parts[3]], {"q": 1e-4, "v": 1e-3}, model)
    assert [len(w.t) for w in apart] == [100, 50]


def test_commands_that_change_within_a_step_count_as_held_at_their_mean(model):
    """A command that rises by 2 N m in a step of eight samples moves the angle otherwise than its mean does."""
    commands = np.tile(np.linspace(-1.0, 1.0, 8), 12)
    window = recorded(commands)
    both = [WindowPrediction("bench", True, window.t, window.states, window.states, window.states, window.states,
                             window.inputs, np.ones_like(window.states))]  # fmt: skip
    found = transitions(both, ["q", "v"], model, {}, 8 / RATE)
    for start, then in zip(found.start, found.then, strict=True):
        assert start[2] == pytest.approx(0.0, abs=1e-12)
        held = moved(start[:2], start[2], 8 / RATE)
        assert then == pytest.approx(held, abs=2e-5)
    plain = window.states[8] - moved(window.states[0], 0.0, 8 / RATE)
    assert abs(plain[0]) > 1e-3  # what the change alone does, fifty times as much


def test_only_transitions_that_begin_in_X_count(model):
    window = recorded(np.sin(np.arange(400) / 20.0))
    whole, sigma = seen([window], {"q": 1e-4}, model)
    found = transitions(whole, list(sigma), model, {}, 0.05)
    inside = within(found, model, {"q": (-0.1, 0.1)})
    assert 0 < len(inside.start) < len(found.start)
    assert np.all(np.abs(inside.start[:, 0]) <= 0.1)
    assert len(inside.then) == len(inside.start)


@pytest.mark.parametrize("measured", [{"q": 1e-4}, {"q": 1e-4, "v": 1e-3}])
def test_no_transition_begins_or_ends_at_a_reading_that_is_none(model, measured):
    """A straight line bridges what was not read: a bound must not take it for what the plant did."""
    window = recorded(np.sin(np.arange(400) / 20.0))
    read, used = window.states[:, : len(measured)].copy(), np.ones((400, len(measured)))
    read[150:170], used[150:170, 0] = 7.0, 0.0
    lost = WindowPrediction("bench", True, window.t, read, read, read, window.states, window.inputs, used)
    whole, sigma = seen([lost], measured, model)
    found = transitions(whole, list(sigma), model, {}, 0.05)
    assert len(found.start) > 20
    assert np.abs(found.start[:, :2]).max() < 3.0
    assert np.abs(found.then).max() < 3.0
