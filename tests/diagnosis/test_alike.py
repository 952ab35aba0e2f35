"""Which candidates are tried at a turn: of those of nearly one direction the best alone."""

from types import SimpleNamespace

import numpy as np

from simgap.diagnosis.search.equivalence import _alike as _in_place_of_one
from simgap.diagnosis.search.equivalence import _Span
from simgap.diagnosis.search.explanations import _alike, _distinct
from simgap.diagnosis.search.scoring import Score
from simgap.diagnosis.simulation.sensitivity import scaled
from simgap.effects.base import Start


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


def test_what_moves_predictions_nearly_as_an_effect_does_is_begun_in_its_place():
    """A gain does all but a thousandth of what a mass does, a bias half of it."""
    rng = np.random.default_rng(71106)
    mass, rub, other = rng.normal(size=(3, 500))
    gain, bias = mass + 0.03 * other, mass + other
    gram, size = scaled(np.column_stack([mass, rub, gain, bias]).T @ np.column_stack([mass, rub, gain, bias]))
    members = [_member("m", 0), _member("b", 1)]
    start = Start(1, lambda c: {"x": c[0]})
    span = _Span(2, ((_member("gain", 2), start), (_member("bias", 3), start)), gram, size)
    chosen = SimpleNamespace(members=members, fit=SimpleNamespace(slots=(0, 1), theta=np.array([1.2, 0.3])))
    sets = [([c.key[0] for c in own], columns) for own, columns in _in_place_of_one(chosen, span, np.array([1.0, 0.0]))]
    assert sets == [(["b", "gain"], [1, 2])]


def _member(name, slot):
    effect = SimpleNamespace(parameters=(SimpleNamespace(shape=False),))
    return SimpleNamespace(key=(name, ""), slots=(slot,), effect=effect)
