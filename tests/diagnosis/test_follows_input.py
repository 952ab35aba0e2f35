"""Does what is left follow the input? Against residuals that are made by hand."""

from types import SimpleNamespace

import numpy as np

from simgap.diagnosis.search.noise_colour import follows_input

SAMPLES = np.arange(2000)
ROWS = np.arange(0, 2001, 200)


def problem(u):
    return SimpleNamespace(samples=SAMPLES, rows=ROWS, u=u[:, None])


def command():
    t = 0.005 * SAMPLES
    return np.sin(2 * np.pi * 0.7 * t) + 0.5 * np.sin(2 * np.pi * 2.3 * t + 1.0)


def test_noise_does_not():
    found = [
        follows_input(problem(command()), np.random.default_rng(seed).standard_normal((2000, 2))) for seed in range(200)
    ]
    assert not any(found)


def test_what_trails_the_input_does():
    white = np.random.default_rng(0).standard_normal((2000, 2))
    white[:, 1] += 0.3 * np.roll(command(), 6)
    assert follows_input(problem(command()), white)


def test_what_turns_round_with_the_input_does():
    white = np.random.default_rng(0).standard_normal((2000, 1)) + 0.3 * np.sign(command())[:, None]
    assert follows_input(problem(command()), white)


def test_without_an_input_there_is_nothing_to_follow():
    white = np.random.default_rng(0).standard_normal((2000, 1)) + command()[:, None]
    assert not follows_input(problem(np.zeros(2000)), white)


def test_noise_that_a_controller_feeds_back_does_not():
    """The command of an instant is made from its reading; what it does comes later."""
    for seed in range(50):
        white = np.random.default_rng(seed).standard_normal((2000, 1))
        assert not follows_input(problem(0.3 * command() - white[:, 0]), white)
