"""Small files that say they are huge are refused before they are unpacked."""

import resource
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgap import reading as unpacked
from simgap.errors import UserError
from simgap.io.controller_file import load_controller
from simgap.io.recordings.tables import read_recording
from simgap.io.results import read_parquet, table, write_parquet

ROWS = 3_000_000


@pytest.fixture
def small_machine(monkeypatch):
    """One with 40 MB of memory."""
    monkeypatch.setattr(unpacked, "MOST", 10_000_000)


def test_a_recording_that_repeats_one_value(tmp_path, small_machine):
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({"t": np.zeros(ROWS), "q": np.zeros(ROWS), "other": np.zeros(ROWS)}), path)
    assert path.stat().st_size < 200_000
    with pytest.raises(UserError, match=r"run\.parquet: holds 0\.048 GB unpacked"):
        read_recording(path, ["q"], "t", "trace")


def test_columns_that_are_not_read_do_not_count(tmp_path, small_machine):
    path = tmp_path / "run.parquet"
    columns = {"t": np.arange(1000.0), "q": np.zeros(1000)} | {f"c{k}": np.zeros(1000) for k in range(2000)}
    pq.write_table(pa.table(columns), path)
    assert len(read_recording(path, ["q"], "t", "trace").time) == 1000


def test_a_table_of_results_that_repeats_one_value(tmp_path, small_machine):
    write_parquet(tmp_path / "a.parquet", table({"x": np.zeros(ROWS)}, {}, {}, {}))
    with pytest.raises(UserError, match=r"a\.parquet: holds 0\.024 GB unpacked"):
        read_parquet(tmp_path / "a.parquet")


def test_a_controller_of_zeros(tmp_path, small_machine):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("about.npy", "w") as stream:
        np.lib.format.write_array(stream, np.zeros(100_000_000, np.uint8))
    assert path.stat().st_size < 200_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=r"a\.npz: holds 0\.1 GB unpacked.*fewer cells"):
        load_controller(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000
