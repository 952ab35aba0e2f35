"""Which candidates are tried at a turn: of those of nearly one direction the best alone."""

from types import SimpleNamespace

import numpy as np

from simgap.diagnosis.search.explanations import _alike, _distinct
from simgap.diagnosis.search.scoring import Score


def _seen(columns):
    """A screen of one free parameter, its first column, and of candidates."""
    return SimpleNamespace(own=1, gram=columns.T @ columns)


def _score(name, drop, *columns):
    return Score(SimpleNamespace(key=(name, "")), drop, {}, columns)


def test_a_mass_a_gain_and_an_inertia_take_one_place():
    """Three of four columns differ by a thousandth beside what the free parameter can do; friction is another."""
    rng = np.random.default_rng(90445)
    free, push, rub = rng.normal(size=(3, 500))
    nearly = [push + 3.0 * k * free + 1e-3 * rng.normal(size=500) for k in range(3)]
    alike = _alike(_seen(np.column_stack([free, *nearly, rub])))
    mass, gain, inertia, friction = (
        _score(n, drop, k) for n, drop, k in (("mass", 9.0, 1), ("gain", 8.0, 2), ("inertia", 7.0, 3), ("rub", 6.0, 4))
    )
    assert _distinct([mass, gain, inertia, friction], alike) == [mass, friction]


def test_trials_of_finite_size_are_apart_unless_they_promise_the_same():
    alike = _alike(_seen(np.random.default_rng(3).normal(size=(50, 2))))
    dead, dry, same = _score("dead", 9.0), _score("dry", 8.0), _score("same", 8.0)
    assert _distinct([dead, dry, same], alike) == [dead, dry]
