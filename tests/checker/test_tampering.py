"""Changed certificates: none that is false is accepted; 300 of them, of eight kinds, in benchmarks/tampering.py."""

import numpy as np
import pytest
import tampering


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    return tampering.originals(tmp_path_factory.mktemp("certificates"), ("cart",))


def test_a_true_certificate_is_accepted_and_no_point_refutes_it(cart):
    status, false, words = tampering.judged(cart["cart"], np.arange(0), np.random.default_rng(1))
    assert (status, false) == (0, None), words


def test_no_changed_certificate_is_accepted_and_false(cart):
    rows = tampering.attack(cart, range(40), say=lambda text: None)
    assert not [row for row in rows if row["checker"] == "accepted" and row["false"]]
    assert sum(row["checker"] == "rejected" and row["false"] is not None for row in rows) >= 20
    assert len({row["false"] for row in rows}) >= 4


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    return tampering.originals(tmp_path_factory.mktemp("tasks"), ("rounds", "settling", "errand"))


def test_no_changed_certificate_of_a_task_is_accepted_and_false(tasks):
    rows = tampering.attack(tasks, range(60), say=lambda text: None)
    assert not [row for row in rows if row["checker"] == "accepted" and row["false"]]
    assert sum(row["checker"] == "rejected" and row["false"] is not None for row in rows) >= 30
    assert len({row["false"] for row in rows}) >= 7


@pytest.mark.parametrize(
    ("name", "blind", "false"),
    [
        ("implies", lambda automaton, formula: True, "an automaton that accepts what breaks the formula"),
        ("false_letters", lambda c: (np.zeros(c.size, bool), "", False), "a letter that is not true"),
    ],
)
def test_the_attack_finds_a_checker_that_believes_a_task(tasks, monkeypatch, name, blind, false):
    import sets

    monkeypatch.setattr(sets, name, blind)
    monkeypatch.setattr(tampering, "CHANGES", (tampering._watched,))
    rows = tampering.attack(tasks, range(45), say=lambda text: None)
    assert [row for row in rows if row["checker"] == "accepted" and row["false"] == false]


def test_the_attack_finds_a_checker_that_believes_what_is_said_to_wrap_around(cart, monkeypatch):
    import sets

    monkeypatch.setattr(sets, "unrepeated", lambda c: None)
    monkeypatch.setattr(tampering, "CHANGES", (tampering._wrapped,))
    rows = tampering.attack(cart, range(12), say=lambda text: None)
    assert [
        row for row in rows if row["checker"] == "accepted" and row["false"] == "a step to where nothing is promised"
    ]
