"""The first inputs of every kind of `benchmarks/fuzz.py`, and those that once were findings."""

import random
import warnings

import pytest
from hostile import KINDS, prepare

from simgap.errors import SimgapError

FOUND: dict[str, tuple[int, ...]] = {"JSON results": (2015,), "Parquet recordings": (3777, 7129, 10804)}
"""Numbers of inputs that were read wrongly once, by kind."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    prepare(folder)
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_each_input_is_read_or_refused_in_one_line(place, monkeypatch, kind):
    monkeypatch.chdir(place)
    told = []
    for number in (*range(40), *FOUND.get(kind, ())):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                KINDS[kind][1](random.Random(f"{kind} {number}"), place)
        except SimgapError as error:
            told.append(str(error))
    assert all(line.isprintable() for line in told)
    assert told or kind == "command lines"
