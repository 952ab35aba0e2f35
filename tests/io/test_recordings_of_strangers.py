"""Recordings that no program should have written: each is one short line with its file."""

import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgap import reading
from simgap.config.measured import Mask, MeasuredSection
from simgap.diagnosis.record.channels import Channel
from simgap.diagnosis.record.traces import read_traces
from simgap.errors import UserError
from simgap.io.recordings.tables import read_recording

T = np.arange(3.0)


def parquet(columns, units=None, names=None):
    def write(path):
        arrays = [pa.array(values) for values in columns.values()]
        named = names or list(columns)
        fields = [
            pa.field(n, a.type, metadata={b"unit": units[n]} if units and n in units else None)
            for n, a in zip(named, arrays, strict=True)
        ]
        pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path)

    return "run.parquet", write


def csv(text):
    return "run.csv", lambda path: path.write_bytes(text if isinstance(text, bytes) else text.encode())


def sparse(path):
    path.write_bytes(b"t,q\n" + b"0,1\n" * 500)
    os.truncate(path, 4 * reading.MOST + 1)


LISTS = [[1.0], [2.0], [3.0]]
REFUSED = {
    "list column": (parquet({"t": T, "q": LISTS}), "'q' holds list<.*>, not numbers"),
    "struct column": (parquet({"t": T, "q": [{"a": 1}] * 3}), "'q' holds struct<.*>, not numbers"),
    "list of times": (parquet({"t": LISTS, "q": T}), "'t' holds list<.*>, not numbers"),
    "list of traces": (parquet({"t": T, "q": T, "trace": LISTS}), "'trace' holds list<.*>, not names of traces"),
    "bytes as traces": (parquet({"t": T, "q": T, "trace": [b"\xff\xfe"] * 3}), "not names of traces"),
    "unit": (parquet({"t": T, "q": T}, {"q": b"\xff\xfe"}), "unit of column 'q' is not UTF-8"),
    "unit of time": (parquet({"t": T, "q": T}, {"t": b"\xff\xfe"}), "unit of column 't' is not UTF-8"),
    "column twice": (parquet({"t": T, "q": T, "p": T}, names=["t", "q", "q"]), "two columns named 'q'"),
    "digits of another script": (csv("t,q\n0,1\n1,١٢\n2,3\n"), "row 2, column 'q': '١٢' is not a finite number"),
    "underscore": (csv("t,q\n0,1\n1,1_0\n2,3\n"), "row 2, column 'q'"),
    "long cell": (csv("t,q\n0," + "x" * 20_000 + "\n"), "row 1, column 'q'"),
    "many columns": (csv(",".join(f"c{k}" for k in range(5000)) + "\n"), "no time column 't' among"),
    "late bytes": (csv(b"t,q\n" + b"0,1\n" * 500 + b"1,\xff\xfe\n"), "run.csv"),
    "ragged bytes": (csv(b"t,q\n" + b"0,1\n" * 500 + b"1,\xff\xfe,3\n"), "run.csv"),
    "sparse": (("run.csv", sparse), "has .* bytes; the most are"),  # an hour to hash, and no byte on the disk
    "text below an empty cell": (csv("t,q\n0,\n1,abc\n"), "row 2, column 'q': 'abc' is not a finite number"),
    "text in Parquet": (parquet({"t": T, "q": ["", "1", "abc"]}), "row 3, column 'q': 'abc' is not a finite number"),
    "null bytes": (csv(b"t,q\n0,\x00\n"), "row 1, column 'q'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_one_short_line(tmp_path, name):
    (file, write), match = REFUSED[name]
    write(tmp_path / file)
    with pytest.raises(UserError, match=match) as caught:
        read_recording(tmp_path / file, ["q"], "t", "trace")
    told = str(caught.value).replace(str(tmp_path), "")
    assert "\n" not in told
    assert file in told
    assert len(told) < 400


@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run"])
def test_a_folder_is_no_file(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(UserError, match="is a folder, not a file"):
        read_recording(tmp_path / name, ["q"], "t", "trace")


def test_a_folder_of_a_bag_names_the_files_in_it(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(b"")
    with pytest.raises(UserError, match=r"is a folder, not a file\. Give the files in it: bag/\*\.mcap"):
        read_recording(tmp_path / "bag", ["q"], "t", "trace", "bag")


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"SQLite format 3\0", "SQLite.*ros2 bag convert"),
        (b"#ROSBAG V2.0\n", "a bag of ROS 1"),
        (b"\x1f\x8b\x08", "compressed"),
    ],
)
def test_what_is_no_text_is_called_by_its_name(tmp_path, start, said):
    (tmp_path / "run.bin").write_bytes(start + b"\xff\xfe" * 100)
    with pytest.raises(UserError, match=rf"run\.bin: is .*{said}"):
        read_recording(tmp_path / "run.bin", ["q"], "t", "trace")


EMPTY = {"csv": "", "blank.csv": " ", "na.csv": "NaN", "json": "null", "nan.json": "NaN"}


@pytest.mark.parametrize("kind", EMPTY)
def test_a_row_with_an_empty_cell_is_one_that_is_missing(tmp_path, kind):
    """The record is the one of a file without that row; a count of them is said."""
    rng, lost = np.random.default_rng(7), {"q": 30, "u": 71}
    rows = [[f"{0.01 * k:.2f}", *(f"{x:.6f}" for x in rng.standard_normal(2))] for k in range(100)]

    def read(name, rows):
        lines = [",".join(("t", "q", "u")), *map(",".join, rows)]
        if kind.endswith("json"):
            lines = [f'{{"t": {t}, "q": {q}, "u": {u}}}' for t, q, u in rows]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        raw = read_recording(tmp_path / name, ["q", "u"], "t", "trace")
        channels = [Channel("q", "rad", False, "q"), Channel("u", "N*m", True, "u")]
        return read_traces([raw], channels, MeasuredSection(window_s=0.2))

    without = read(f"without.{kind}", [row for k, row in enumerate(rows) if k not in lost.values()])
    for column, k in lost.items():
        rows[k][("t", "q", "u").index(column)] = EMPTY[kind]
    found = read(f"empty.{kind}", rows)
    (one,), (other,) = found.record.traces, without.record.traces
    for name in ("t", "y", "u"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert [w.split(": ", 1)[1] for w in found.warnings] == ["2 rows have an empty cell and count as missing"]
    assert found.files[0].rows - found.files[0].rows_used == 2
    assert without.warnings == ()


def traces(folder, *files, **section):
    """Files of two traces, of 190 rows and of 10, at 100 Hz; of each, by column, which rows have an empty cell."""
    channels = [Channel("q", "rad", False, "q"), Channel("v", "rad/s", False, "v"), Channel("u", "N*m", True, "u")]
    tables = []
    for n, empty in enumerate(files):
        rows = [
            ",".join(
                ("ab"[k >= 190], f"{0.01 * k:.2f}", *("" if k in own else f"{k * k % 7}" for own in empty.values()))
            )
            for k in range(200)
        ]
        path = folder / f"run{n}.csv"
        path.write_text("\n".join([",".join(("trace", "t", *empty)), *rows]) + "\n")
        tables.append(read_recording(path, ["q", "v", "u"], "t", "trace", path.name))
    return read_traces(tables, channels, MeasuredSection(window_s=0.08, **section))


def test_many_empty_cells_are_refused(tmp_path):
    """Columns of two rates leave most rows with one: no row is whole, and the file cannot say which belong together."""
    rates = {"q": range(0, 200, 2), "u": range(1, 200, 2)}
    said = r"run0\.csv: measured\.columns\.q: row 1, 'q': the cell is empty; 200 of 200 rows .* common times"
    with pytest.raises(UserError, match=said):
        traces(tmp_path, rates)


def test_empty_cells_count_where_a_column_is_used(tmp_path):
    """The other file has no v."""
    found = traces(tmp_path, {"q": (), "v": range(200), "u": ()}, {"q": (), "u": ()})
    assert [note.rows_used for note in found.files] == [200, 200]
    assert not any("empty" in words for words in found.warnings)


def test_empty_cells_count_where_no_mask_is(tmp_path):
    empty = {"q": range(5, 65), "u": (7, 170)}
    found = traces(tmp_path, empty, masks=[Mask(trace="a", drop=(0.0, 0.7))])
    assert found.warnings == ("run0.csv: 1 row has an empty cell and counts as missing",)
    assert sum(note.rows_used for note in found.files) == 200 - 71 - 1
    with pytest.raises(UserError, match=r"row 72, 'u': the cell is empty; 10 of 129 rows"):
        traces(tmp_path, {"q": range(5, 65), "u": (*range(7, 80), 170)}, masks=[Mask(trace="a", drop=(0.0, 0.7))])


@pytest.mark.parametrize("others", [(), ({"q": (), "u": ()},)])
def test_a_trace_without_a_whole_row_is_refused(tmp_path, others):
    """It has a twentieth of the rows of its file."""
    said = (
        r"^run\d\.csv: measured\.columns\.u: row 191, 'u': the cell is empty; 10 of 10 rows of its trace have one\. At"
    )
    with pytest.raises(UserError, match=said):
        traces(tmp_path, *others, {"q": (), "u": range(190, 200)})
    with pytest.raises(UserError, match=r"row 1, 'u': the cell is empty; 200 of 200 rows have one"):
        traces(tmp_path, *others, {"q": (), "u": range(200)})
    found = traces(tmp_path, *others, {"q": (), "u": range(190, 200)}, masks=[Mask(trace="b", drop=(0.0, 9.0))])
    assert {trace.name for trace in found.record.traces} == {"run0:a", "run1:a"} if others else {"run0:a"}
