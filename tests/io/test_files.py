"""Files appear whole or not at all, the same content is the same bytes, damage is named."""

import json
import signal
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgap.errors import UserError
from simgap.io.atomic import atomic
from simgap.io.recordings import tables as diagnosis_tables
from simgap.io.recordings.tables import read_recording
from simgap.io.results import read_json, read_parquet, stack, table, write_json, write_parquet


def test_nothing_half_written_is_left(tmp_path):
    def fail():
        with atomic(tmp_path / "sub" / "a.txt") as temporary:
            temporary.write_text("half")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail()
    assert list((tmp_path / "sub").iterdir()) == []


def test_what_a_killed_writer_left_goes_with_the_next_write(tmp_path):
    code = """
import os, signal, sys
from pathlib import Path
from simgap.io.recordings import tables as diagnosis_tables
from simgap.io.atomic import atomic
with atomic(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    path = tmp_path / "a.json"
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    of_others = [tmp_path / f".a.{'0' * 8}-{2**22 - 1}-x.json", tmp_path / ".a.notes.json", tmp_path / ".ab.json"]
    for other in of_others:
        other.write_text("mine")
    with atomic(path) as one, atomic(path) as another:  # a writer that lives keeps its own
        one.write_text("1")
        another.write_text("2")
        assert not left.exists()
    assert {*tmp_path.iterdir()} == {path, *of_others}


def test_a_table_keeps_units_types_and_provenance_and_its_bytes_repeat(tmp_path):
    x = np.linspace(0, 1, 1000)
    content = table({"x": x}, {"x": "rad"}, {"case": "c", "seed": 3, "eps": 0.1, "none": None}, {"made": "here"})
    for name in ("a.parquet", "b.parquet"):
        write_parquet(tmp_path / name, content)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    back = read_parquet(tmp_path / "a.parquet")
    assert back.schema.field("x").metadata == {b"unit": b"rad"}
    assert str(back.schema.field("seed").type) == "int64"
    assert str(back.schema.field("eps").type) == "double"
    assert back.column("case").to_pylist()[:2] == ["c", "c"]
    assert json.loads(back.schema.metadata[b"provenance"]) == {"made": "here"}
    assert np.array_equal(stack(back, ["x"])[:, 0], x)
    assert pq.ParquetFile(tmp_path / "a.parquet").metadata.row_group(0).column(0).compression == "ZSTD"


@pytest.mark.parametrize("keep", [0, 10, -50])
def test_a_damaged_table_is_one_line_with_file_and_remedy(tmp_path, keep):
    path = tmp_path / "a.parquet"
    write_parquet(path, table({"x": np.arange(100.0)}, {}, {}, {}))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UserError, match="Delete it") as caught:
        read_parquet(path)
    assert "\n" not in str(caught.value)
    assert "a.parquet" in str(caught.value)


def test_documents_read_back_and_repeat(tmp_path):
    content = {"a": np.float64(0.1), "b": np.arange(3), "c": [float("nan"), float("inf")], "d": (1, 2)}
    write_json(tmp_path / "a.json", content)
    assert read_json(tmp_path / "a.json") == {"a": 0.1, "b": [0, 1, 2], "c": [None, "inf"], "d": [1, 2]}
    (tmp_path / "a.json").write_text('{"a": ')
    with pytest.raises(UserError, match="damaged"):
        read_json(tmp_path / "a.json")


def test_a_key_that_stands_twice_an_edit_and_a_foreign_document_are_refused(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"eps": 0.1, "gap": {"x": [1, 2.5]}})
    text = path.read_text()
    assert list(json.loads(text)) == ["eps", "gap", "checksum"]
    for wrong, match in (
        (text.replace("0.1", "0.2"), "checksum does not fit"),
        (text.replace('"eps": 0.1', '"eps": 0.2, "eps": 0.1'), "checksum does not fit"),
        (text.replace("2.5", "2.5, NaN"), "checksum does not fit"),
        (text.replace("2.5", "1e400"), "checksum does not fit"),
        (text.replace("0.1", "1" * 5001), "damaged"),
        ("[" * 100_000, "damaged"),
        ("{}", "its checksum is missing"),
        ("[]", "not a result"),
        ("null", "not a result"),
        (json.dumps({"eps": 0.1}), "its checksum is missing"),
    ):
        path.write_text(wrong)
        with pytest.raises(UserError, match=match) as caught:
            read_json(path)
        assert len(str(caught.value)) < 500
    with pytest.raises(UserError, match="damaged"):
        read_json(tmp_path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match="damaged"):
        read_json(path)


def shard():
    rng = np.random.default_rng(3)
    columns = {name: rng.normal(size=400) for name in ("x", "v", "u", "next_x", "next_v")}
    return table(columns, {"x": "rad"}, {"case": "c", "shard": 0}, {"stage": "rollouts", "seeds": {}})


def traces():
    names = ("controller", "plant")
    parts = [
        table({"run": np.full(50, k), "x": np.linspace(0, k, 50)}, {}, dict(zip(names, pair, strict=True)), {})
        for k, pair in enumerate([("gap", "simulator"), ("nominal", "simulator"), ("gap", "nominal model")])
    ]
    return pa.concat_tables(parts).unify_dictionaries()


@pytest.mark.parametrize("made", [shard, traces])
def test_every_flipped_bit_of_a_table_is_refused_in_one_line(tmp_path, made):
    path, rng = tmp_path / "a.parquet", np.random.default_rng(14)
    write_parquet(path, made())
    whole = path.read_bytes()
    footer = 8 * (len(whole) - 8 - int.from_bytes(whole[-8:-4], "little"))
    bits = [*rng.choice(8 * len(whole), 300, replace=False), *rng.integers(footer, 8 * len(whole), 300)]
    for bit in bits:
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(damaged)
        with pytest.raises(UserError, match="not a whole Parquet file") as caught:
            read_parquet(path)
        assert "\n" not in str(caught.value)
    path.write_bytes(whole)
    assert read_parquet(path).equals(made())


def test_a_table_of_others_is_no_result_and_is_still_a_recording(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": np.arange(3.0), "x": np.zeros(3)}), path)
    with pytest.raises(UserError, match="checksum is missing"):
        read_parquet(path)
    assert read_recording(path, ["x"], "t", "trace").columns["x"].tolist() == [0.0, 0.0, 0.0]


def test_a_recording_of_our_own_is_held_to_its_checksum(tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(path, table({"t": np.arange(3.0), "x": np.ones(3)}, {"x": "rad"}, {}, {}))
    assert read_recording(path, ["x"], "t", "trace").units == {"x": "rad"}
    whole = path.read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 4] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(UserError, match="its checksum does not fit"):
        read_recording(path, ["x"], "t", "trace")


def test_a_recording_that_changes_while_it_is_read_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("t,x\n0,1\n1,2\n")
    read = diagnosis_tables.read_csv_columns

    def slow(*arguments):
        found = read(*arguments)
        path.write_text("t,x\n0,1\n1,3\n")  # a logger that still writes
        return found

    monkeypatch.setattr(diagnosis_tables, "read_csv_columns", slow)
    with pytest.raises(UserError, match="was changed while it was read"):
        read_recording(path, ["x"], "t", "trace")
