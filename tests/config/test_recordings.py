"""Recordings that a case names by patterns."""

from __future__ import annotations

from simgap.config.measured import matching_files


def test_a_pattern_brings_its_files_sorted_and_each_once(tmp_path):
    for name in ("b.csv", "a.csv", "c.txt"):
        (tmp_path / name).write_text("")
    found = matching_files(tmp_path, ["b.csv", "*.csv"])
    assert found == [(0, tmp_path / "b.csv"), (1, tmp_path / "a.csv")]


def test_what_is_no_pattern_stays_a_name(tmp_path):
    assert matching_files(tmp_path, ["runs/**.csv"]) == [(0, tmp_path / "runs/**.csv")]
