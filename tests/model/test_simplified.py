"""Simplified expressions are kept between processes, whole and the same, or made again."""

from __future__ import annotations

import pytest
import sympy as sp

from simgap.model.symbolic import symbol
from simgap.plants.urdf import simplified

Q, M = symbol("q"), symbol("rod.m")
MATRIX = sp.Matrix([[sp.sin(Q) ** 2 + sp.cos(Q) ** 2, sp.Rational(1, 3) * M * (Q + 1)], [0, Q / M]])


@pytest.fixture
def made(tmp_path, monkeypatch):
    """How often something was made, the folder, and the call."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []

    def how(matrix):
        calls.append(1)
        return matrix.applyfunc(sp.simplify)

    return calls, tmp_path / "simgap" / "expressions", lambda matrix=MATRIX: simplified(matrix, how, "1")


def test_it_is_made_once_and_reads_back_the_same(made):
    calls, folder, call = made
    first, second = call(), call()
    assert len(calls) == 1
    assert sp.srepr(first) == sp.srepr(second) == sp.srepr(MATRIX.applyfunc(sp.simplify))
    assert len(list(folder.iterdir())) == 1
    call(MATRIX * 2)
    assert len(calls) == 2


@pytest.mark.parametrize("damage", [b"", b"no\n{}", None])
def test_what_is_damaged_is_made_again(made, damage):
    calls, folder, call = made
    call()
    (path,) = folder.iterdir()
    path.write_bytes(path.read_bytes().replace(b'"3"', b'"4"') if damage is None else damage)
    assert call() == MATRIX.applyfunc(sp.simplify)
    assert len(calls) == 2


def test_what_is_not_written_here_is_not_kept(made):
    calls, folder, call = made
    for _ in range(2):
        assert call(sp.Matrix([[sp.Abs(Q)]]))[0] == sp.Abs(Q)
    assert len(calls) == 2
    assert not folder.exists()


def test_without_a_place_nothing_is_kept_and_nothing_fails(made):
    calls, folder, call = made
    folder.parent.mkdir()
    folder.write_text("a file")
    call()
    assert len(calls) == 1
