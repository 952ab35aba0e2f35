"""The recipe of a law of the noise: a kind joins `NOISES`, and the benchmark says if a right answer survives it."""

import re

import pytest
from scipy.signal import lfilter


@pytest.fixture
def benchmark(root, monkeypatch):
    monkeypatch.syspath_prepend(str(root / "benchmarks"))
    import noise_colours

    return noise_colours


def test_an_answer_survives_a_kind_that_joins(benchmark, monkeypatch):
    """AR(1) noise: a law that the diagnosis knows."""
    remembering = benchmark._coloured(lambda white: lfilter([1.0], [1.0, -0.9], white))
    monkeypatch.setitem(benchmark.NOISES, "AR(1)", remembering)
    found = benchmark.one("oscillator", "AR(1)", friction=True, seed=0, budget=None)
    assert found["verdict"] == "attributed"
    assert found["exact"]
    assert "| AR(1) | 1 | 1 | 1 |" in benchmark.table([found])


def test_files_that_the_recipes_name_are_there(root):
    text = (root / "CONTRIBUTING.md").read_text()
    named = set(re.findall(r"`([\w/]+\.py)`", text[text.index("## Adding things") : text.index("## Documentation")]))
    assert len(named) > 8
    places = root, root / "simgap", root / "simgap/diagnosis"
    assert {name for name in named if not any((folder / name).is_file() for folder in places)} == set()
