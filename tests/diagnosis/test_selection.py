"""Which of the sets that were fitted is taken."""

from __future__ import annotations

from types import SimpleNamespace

from simgap.diagnosis.search.selection import plainest


def _set(chi2: float, count: int, physical: bool = True) -> SimpleNamespace:
    return SimpleNamespace(fit=SimpleNamespace(chi2=chi2), count=count, physical=physical, bic=chi2 + 7.0 * count)


def _search(*tried: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(problem=SimpleNamespace(size=1000), tried=dict(enumerate(tried)))


def test_effects_that_take_a_little_of_a_coloured_noise_are_not_asked_for():
    one, three = _set(2600.0, 1), _set(2500.0, 3)
    assert (
        plainest(_search(_set(9000.0, 0), one, _set(2550.0, 2), three, _set(2510.0, 1, physical=False)), three) is one
    )


def test_an_effect_that_takes_a_fifth_is_asked_for():
    two = _set(2300.0, 2)
    assert plainest(_search(_set(9000.0, 0), _set(2600.0, 1), two), two) is two


def test_a_set_down_to_its_noise_is_the_plainest():
    found = _set(990.0, 2)
    assert plainest(_search(_set(1030.0, 1), found), found) is found
