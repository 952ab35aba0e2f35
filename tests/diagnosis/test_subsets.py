"""Sets of effects by the normal equations of one linearisation, against least squares over all of them."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.search.equivalence import Rival
from simgap.diagnosis.search.scoring import Screen
from simgap.diagnosis.search.selection import best_subsets
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.verdict import sets
from simgap.diagnosis.verdict.answer import contested


def _screen(columns: np.ndarray, residual: np.ndarray, own: int) -> Screen:
    """Columns (n, p), the first `own` of free parameters, the others of effects of one parameter."""
    start = SimpleNamespace(amplitude=None, point=lambda c: {"a": c[0]})
    asked = []
    for j in range(own, columns.shape[1]):
        effect = SimpleNamespace(
            contains=None, physical=lambda v: True, parameters=(SimpleNamespace(symbol="a"),), name=f"e{j}"
        )
        asked.append((Candidate(effect, "x", (j,)), start, (j,)))
    at = SimpleNamespace(slots=tuple(range(own)), theta=np.zeros(columns.shape[1]))
    return Screen(
        at, own, tuple(asked), columns.T @ columns, columns.T @ residual, float(residual @ residual), frozenset()
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_pair_that_is_worth_little_singly_is_found(seed):
    """Two columns that nearly cancel in what is missing: alone another one is best, together they leave nothing."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((200, 9))
    columns[:, 3] = -columns[:, 5] + 0.05 * rng.standard_normal(200)
    missing = 20.0 * columns[:, 3] + 20.0 * columns[:, 5]
    columns[:, 7] = missing + 0.3 * np.linalg.norm(missing) / np.sqrt(200) * rng.standard_normal(200)
    residual = 0.4 * columns[:, 0] + missing
    found = best_subsets(_screen(columns, residual, 2), 2)
    left = {}
    for pair in itertools.combinations(range(2, 9), 2):
        some = columns[:, [0, 1, *pair]]
        fitted = np.linalg.lstsq(some, residual, rcond=None)[0]
        left[pair] = float(np.sum((residual - some @ fitted) ** 2))
    best = min(left, key=left.get)
    assert best == (3, 5)
    assert best_subsets(_screen(columns, residual, 2), 1)[0].members[0].key == ("e7", "x")
    assert sorted(c.slots[0] for c in found[0].members) == [3, 5]
    assert found[0].values[3] == pytest.approx(20.0, rel=1e-4)
    assert found[0].values[0] == pytest.approx(0.4, rel=1e-3)
    order = sorted(left.values())
    assert [s.left for s in found[1:5]] == pytest.approx(order[1:5], rel=1e-6)


def test_columns_of_one_direction_make_one_set():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((100, 5))
    columns[:, 4] = 3.0 * columns[:, 2]
    residual = columns[:, 2] + columns[:, 1] + 0.1 * rng.standard_normal(100)
    found = best_subsets(_screen(columns, residual, 0), 2)
    assert sorted(c.slots[0] for c in found[0].members) == [1, 2]
    assert {1, 4} not in [{c.slots[0] for c in s.members} for s in found]
    assert {2, 4} not in [{c.slots[0] for c in s.members} for s in found]


def test_a_set_that_fits_as_well_or_clearly_better_than_the_answer_is_called_so():
    def fitted(name, bic):
        effect = SimpleNamespace(phrase=lambda on: f"{name} at the {on}")
        member = SimpleNamespace(effect=effect, on="hinge", key=(name, "hinge"), of_recording=False)
        return SimpleNamespace(members=(member,), bic=bic, keys={(name, "hinge")})

    answer, near = fitted("drag", 100.0), Rival(fitted("a spring", 95.0), False)
    (said,) = contested([Rival(fitted("a spring", 103.0), False, True)], answer)
    assert "a spring at the hinge, fits nearly as well (BIC +3.0)" in said
    assert contested([Rival(fitted("a spring", 103.0), False)], answer) == ()
    (said,) = contested([near], answer)
    assert "a spring at the hinge, fits as well (BIC -5.0)" in said
    (said,) = contested([near, Rival(fitted("friction", 83.0), False, True)], answer)
    assert "friction at the hinge, fits the fitted data better (BIC lower by 17)" in said


@pytest.mark.parametrize(
    ("worse", "level"),
    [
        ([4.0] * 12, False),  # by a little in every window
        ([40.0, *[0.0] * 11], True),  # by as much in one alone
        ([0.1] * 12, True),  # within 2 BIC
    ],
)
def test_a_set_that_is_worse_in_one_window_alone_is_not_told_from_the_answer(monkeypatch, worse, level):
    def fitted(name, chi2):
        fit = SimpleNamespace(theta=np.asarray(chi2), x0=None, chi2=float(np.sum(chi2)))
        return SimpleNamespace(keys=frozenset({(name, "hinge")}), members=(), count=1, fit=fit, bic=fit.chi2 + 5.0)

    usual = 100.0 + np.random.default_rng(7963).normal(0.0, 10.0, 12)
    answer, other = fitted("drag", usual), fitted("a spring", usual + worse)
    search = SimpleNamespace(problem=None, scale=1.0, sound=lambda: [answer, other], reached=lambda e: True)
    monkeypatch.setattr(sets, "window_chi2", lambda problem, theta, x0: theta)
    assert [r.explanation for r in sets.as_good(search, answer)] == [other] * level
    monkeypatch.setattr(search, "reached", lambda e: e is answer)  # what is off the noise is told by its size
    assert [r.explanation for r in sets.as_good(search, answer)] == [other] * (sum(worse) < 2.0)
