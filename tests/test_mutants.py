"""The faults of `benchmarks/mutants.py` can still be put in: a fault whose text is gone is tried no more."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def mutants(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import mutant_list

    return mutant_list.MUTANTS


def test_every_fault_replaces_a_text_that_stands_once_and_names_tests_that_exist(mutants):
    gone = [f"{m.file}: {m.fault}" for m in mutants if (ROOT / m.file).read_text().count(m.old) != 1 or m.old == m.new]
    assert gone == []
    assert {test for m in mutants for test in m.tests if not (ROOT / test.split("::")[0]).is_file()} == set()
