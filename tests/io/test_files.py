"""Files appear whole or not at all, the same content is the same bytes, damage is named."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from simgap.errors import UserError
from simgap.io.atomic import atomic
from simgap.io.documents import read_json, write_json
from simgap.io.parquet import provenance_of, read_parquet, stack, table, write_parquet


def test_nothing_half_written_is_left(tmp_path):
    def fail():
        with atomic(tmp_path / "sub" / "a.txt") as temporary:
            temporary.write_text("half")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail()
    assert list((tmp_path / "sub").iterdir()) == []


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
    assert provenance_of(back) == {"made": "here"}
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
