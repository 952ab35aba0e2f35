"""What makes a file of slow tests run again."""

import pytest

from tests import stale


@pytest.mark.parametrize(
    ("file", "rests_on"),
    [
        ("checker/test_reach.py", {"checker/repeats.py", "tests/checker/checker_runs.py"}),  # the checker is a process
        ("cli/test_tutorial.py", {"docs/tutorials/robot.md", "docs/tutorial/swings.csv"}),
        ("cli/test_notebook.py", {"docs/tutorials/notebook.ipynb"}),
        ("workflow/test_slurm.py", {"rules/gap.smk", "profiles/slurm/config.yaml"}),
        ("gap/test_staircase.py", {"uv.lock", "pyproject.toml", "tests/conftest.py", "configs/cases/pendulum.yaml"}),
    ],
)
def test_a_slow_test_is_stale_when_a_file_that_it_rests_on_has_changed(monkeypatch, file, rests_on):
    changed = set()
    monkeypatch.setattr(stale, "file_digest", lambda path: "new" if stale._name(path) in changed else "old")
    stale._others.cache_clear()
    before, same = stale.made_of(stale.TESTS / file), []
    for name in sorted(rests_on):
        assert (stale.ROOT / name).is_file()
        changed.add(name)
        stale._others.cache_clear()
        same += [name] if stale.made_of(stale.TESTS / file) == before else []
        changed.clear()
    stale._others.cache_clear()
    assert same == []
