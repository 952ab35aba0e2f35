"""Recordings as people bring them: units, wrapped angles, time stamps, masks, gaps, and every mistake in one line."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgap.config.measured import MeasuredSection
from simgap.errors import UserError
from simgap.io.recordings.measured import load_reading
from simgap.model.symbolic import SymbolicModel, Variable, symbol

MODEL = SymbolicModel(
    states=(Variable("q", "rad"), Variable("v", "rad/s")),
    inputs=(Variable("u", "N*m"),),
    parameters={},
    xdot=(symbol("v"), symbol("u")),
)
N, TAU = 500, 0.01


def swing(n=N, tau=TAU):
    t = tau * np.arange(n)
    return {"t": t, "q": 2.0 * np.sin(2 * t), "v": 4.0 * np.cos(2 * t), "u": np.cos(3 * t)}


def write(path, columns, sep=",", fmt="%.17g"):
    names = list(columns)
    rows = [sep.join(c if isinstance(c, str) else fmt % c for c in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([sep.join(names), *rows]) + "\n")
    return path


def read(paths, **section):
    paths = [paths] if not isinstance(paths, list) else paths
    return load_reading(MODEL, MeasuredSection.model_validate(section), paths, paths[0].parent, "case.yaml")


def refusal(paths, **section):
    with pytest.raises(UserError) as error:
        read(paths, **section)
    text = str(error.value)
    assert "\n" not in text
    return text


def test_csv_as_named_in_the_contract(tmp_path):
    data = swing()
    reading = read(write(tmp_path / "run.csv", data))
    (trace,) = reading.record.traces
    assert trace.name == "run"
    assert reading.record.measured == ("q", "v")
    assert reading.record.inputs == ("u",)
    np.testing.assert_array_equal(trace.t, data["t"])
    np.testing.assert_array_equal(trace.y, np.stack([data["q"], data["v"]], axis=1))
    np.testing.assert_array_equal(trace.u[:, 0], data["u"])
    assert reading.files[0].rows == reading.files[0].rows_used == N
    assert reading.warnings == ()


def test_parquet_gives_the_same_as_csv(tmp_path):
    data = swing()
    pq.write_table(pa.table(data), tmp_path / "run.parquet")
    a = read(tmp_path / "run.parquet").record.traces[0]
    b = read(write(tmp_path / "run.csv", data)).record.traces[0]
    np.testing.assert_array_equal(a.y, b.y)
    np.testing.assert_array_equal(a.t, b.t)


def test_a_state_need_not_be_measured(tmp_path):
    data = swing()
    del data["v"]
    assert read(write(tmp_path / "run.csv", data)).record.measured == ("q",)


def test_units_scale_and_offset(tmp_path):
    data = swing()
    mapped = {
        "time": 1e3 * data["t"] + 5.0,
        "angle": np.degrees((data["q"] + np.pi) / -2.0),
        "rpm": data["v"] * 60 / (2 * np.pi),
        "mNm": 1e3 * data["u"],
    }
    reading = read(
        write(tmp_path / "run.csv", mapped),
        time={"column": "time", "unit": "ms"},
        columns={
            "q": {"column": "angle", "unit": "deg", "scale": -2.0, "offset": "-pi", "wrapped": False},
            "v": {"column": "rpm", "unit": "rpm"},
            "u": {"column": "mNm", "unit": "mN*m"},
        },
    )
    trace = reading.record.traces[0]
    np.testing.assert_allclose(trace.t, data["t"] + 0.005, atol=1e-12)
    np.testing.assert_allclose(trace.y, np.stack([data["q"], data["v"]], axis=1), atol=1e-12)
    np.testing.assert_allclose(trace.u[:, 0], data["u"], atol=1e-12)


def test_a_parquet_column_carries_its_own_unit(tmp_path):
    data = swing()
    schema = pa.schema(
        [pa.field("t", pa.float64(), metadata={"unit": "s"}), pa.field("q", pa.float64(), metadata={"unit": "deg"})]
    )
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({"t": data["t"], "q": np.degrees(data["q"])}, schema=schema), path)
    trace = read(path, columns={"u": {"constant": 0.25}}).record.traces[0]
    np.testing.assert_allclose(trace.y[:, 0], data["q"], atol=1e-12)
    assert np.all(trace.u == 0.25)


def test_nanoseconds_since_an_epoch_keep_their_intervals(tmp_path):
    data = swing()
    stamps = 1_700_000_000_000_000_000 + (np.arange(N) * 10_000_000) + np.random.default_rng(1).integers(0, 999, N)
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({**data, "t": stamps}), path)
    trace = read(path, time={"unit": "ns"}).record.traces[0]
    np.testing.assert_allclose(np.diff(trace.t), np.diff(stamps) * 1e-9, rtol=0, atol=1e-12)
    typed = pa.table({**data, "t": pa.array(stamps, pa.timestamp("ns"))})
    pq.write_table(typed, path)
    np.testing.assert_allclose(read(path).record.traces[0].t, trace.t, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0), ("turn", 1.0)])
def test_wrapped_angles_are_found_and_unwrapped(tmp_path, unit, turn):
    data = swing()
    true = 3.0 * data["t"] + 1.0  # about two and a half turns
    data["q"] = np.mod(true / (2 * np.pi), 1.0) * turn
    reading = read(write(tmp_path / "run.csv", data), columns={"q": {"unit": unit}})
    np.testing.assert_allclose(reading.record.traces[0].y[:, 0], true, atol=1e-9)
    assert reading.files[0].unwrapped == ("q",)
    assert "unwrapped" in reading.warnings[0]


def test_an_angle_of_many_turns_is_left_alone(tmp_path):
    data = swing()
    data["q"] = 30.0 * data["t"]
    np.testing.assert_array_equal(read(write(tmp_path / "run.csv", data)).record.traces[0].y[:, 0], data["q"])


def test_jitter_keeps_true_intervals_and_repeats_are_merged(tmp_path):
    data = swing()
    rng = np.random.default_rng(2)
    data["t"] = data["t"] + rng.uniform(0, 0.4 * TAU, N)
    doubled = {k: np.insert(v, 100, v[100]) for k, v in data.items()}
    doubled["q"][100] += 0.02  # a repeat that is not identical: the mean stands
    reading = read(write(tmp_path / "run.csv", doubled))
    trace = reading.record.traces[0]
    np.testing.assert_array_equal(trace.t, data["t"])
    assert reading.files[0].repeated == 1
    assert trace.y[100, 0] == pytest.approx(data["q"][100] + 0.01, abs=1e-12)
    np.testing.assert_array_equal(trace.y[101:, 0], data["q"][101:])


def test_missing_samples_stay_but_a_gap_splits(tmp_path):
    data = swing()
    keep = np.ones(N, dtype=bool)
    keep[[50, 51, 130]] = False  # two and one samples lost: the true interval stays
    keep[250:270] = False  # 0.2 s at 100 Hz: a gap
    reading = read(write(tmp_path / "run.csv", {k: v[keep] for k, v in data.items()}))
    assert [t.name for t in reading.record.traces] == ["run", "run#2"]
    assert reading.files[0].gaps == 1
    assert np.diff(reading.record.traces[0].t).max() == pytest.approx(3 * TAU)
    assert reading.record.traces[1].t[0] == data["t"][270]


def test_traces_of_one_file_and_held_out_ones(tmp_path):
    data = swing()
    label = np.where(np.arange(N) < 200, "b", "a")
    both = {**{k: np.where(label == "a", v, v) for k, v in data.items()}, "trace": list(label)}
    both["t"] = np.where(label == "a", data["t"] - 2.0, data["t"])  # each trace has a clock of its own
    reading = read(write(tmp_path / "run.csv", both), held_out={"traces": ["a"]})
    assert [t.name for t in reading.record.traces] == ["run:b", "run:a"]
    assert reading.held_out == ("run:a",)
    free = load_reading(
        MODEL,
        MeasuredSection.model_validate({"held_out": {"traces": ["c"]}}),
        [tmp_path / "run.csv"],
        tmp_path,
        strict=False,
    )
    assert free.held_out == ()
    assert "a share of these is held out" in free.warnings[-1]
    assert "holds out every trace" in refusal(tmp_path / "run.csv", held_out={"traces": ["a", "b"]})
    assert "'c' is not among the data" in refusal(tmp_path / "run.csv", held_out={"traces": ["c"]})


def test_traces_may_be_interleaved(tmp_path):
    data = swing()
    two = {k: np.repeat(v, 2) for k, v in data.items()}
    two["trace"] = ["x", "y"] * N
    reading = read(write(tmp_path / "run.csv", two))
    for trace in reading.record.traces:
        np.testing.assert_array_equal(trace.t, data["t"])
    assert reading.files[0].repeated == 0


def test_masks_concern_their_file(tmp_path):
    paths = [write(tmp_path / f"{name}.csv", swing()) for name in ("one", "two")]
    masks = [{"file": "one.csv", "keep": [0.0, 3.0]}, {"file": "one", "drop": [1.4, 1.6]}, {"drop": [0.0, 0.1]}]
    reading = read(paths, masks=masks)
    spans = {t.name: (round(t.t[0], 6), round(t.t[-1], 6)) for t in reading.record.traces}
    assert spans == {"one": (0.11, 1.39), "one#2": (1.61, 3.0), "two": (0.11, 4.99)}
    assert reading.files[0].masked == np.count_nonzero((swing()["t"] <= 0.1) | (swing()["t"] > 3.0)) + 21


def test_files_of_the_same_name_and_different_states(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    less = swing()
    del less["v"]
    paths = [write(tmp_path / "a" / "run.csv", swing()), write(tmp_path / "b" / "run.csv", less)]
    reading = read(paths)
    assert reading.record.measured == ("q",)
    assert [t.name for t in reading.record.traces] == ["run", "b/run"]
    assert any("v is not used" in w for w in reading.warnings)
    assert "given twice" in refusal([paths[0], paths[0]])


def test_short_pieces_are_dropped_with_a_count(tmp_path):
    reading = read(write(tmp_path / "run.csv", swing()), masks=[{"drop": [0.5, 0.6]}])
    assert len(reading.record.traces) == 1
    assert (reading.files[0].short_pieces, reading.files[0].short_rows) == (1, 50)
    assert any("1 piece shorter than a window" in w for w in reading.warnings)


@pytest.mark.parametrize("text", [";", "\t"])
def test_other_delimiters_decimal_commas_and_comment_headers(tmp_path, text):
    data = swing()
    rows = [text.join(f"{c:.17g}".replace(".", ",") for c in row) for row in zip(*data.values(), strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("# recorded on the bench\n# " + text.join(data) + "\n" + "\n".join(rows) + "\n")
    np.testing.assert_array_equal(read(path).record.traces[0].y[:, 0], data["q"])


def test_a_delimiter_within_quotes_divides_no_name(tmp_path):
    data = swing()
    rows = [",".join(f"{data[name][k]:.17g}" for name in ("t", "q", "u")) for k in range(N)]
    path, names = tmp_path / "run.csv", ["time; s", "angle, rad", "torque\tNm"]
    path.write_text(",".join(f'"{name}"' for name in names) + "\n" + "\n".join(rows) + "\n")
    section = {"time": {"column": names[0]}, "columns": {"q": {"column": names[1]}, "u": {"column": names[2]}}}
    found = read(path, **section).record.traces[0]
    np.testing.assert_array_equal(found.y[:, 0], data["q"])
    path.write_text(path.read_text() + '"1,5",2\n')
    assert f"row {N + 1} has 2 cells where the header has 3" in refusal(path, **section)


def test_a_cell_that_is_no_number_is_named_by_row(tmp_path):
    data = {k: [f"{x:.9g}" for x in v] for k, v in swing().items()}
    for bad in ("oops", "inf", "-inf"):
        broken = {**data, "q": [*data["q"]]}
        broken["q"][41] = bad
        text = refusal(write(tmp_path / "run.csv", broken))
        assert text.startswith(f"{tmp_path}/run.csv: row 42, column 'q'"), text
    broken = {**data, "t": [*data["t"]]}
    broken["t"][41] = "oops"
    assert "row 42, column 't'" in refusal(write(tmp_path / "run.csv", broken))


def test_a_bad_cell_that_no_one_asked_for_is_not_read(tmp_path):
    data = {**swing(), "comment": ["-"] * N}
    assert read(write(tmp_path / "run.csv", data)).record.rows == N


def test_time_that_runs_backwards_is_named_by_row(tmp_path):
    data = swing()
    data["t"][300] = 1.0
    assert "run.csv: row 301: time runs backwards" in refusal(write(tmp_path / "run.csv", data))


def test_mistakes_name_file_key_and_remedy(tmp_path):
    path = write(tmp_path / "run.csv", swing())
    cases = {
        "no such file": (tmp_path / "none.csv", {}),
        "measured.columns.q.unit: 'kg' cannot be converted to 'rad'": (path, {"columns": {"q": {"unit": "kg"}}}),
        "measured.columns.q.unit: 'wibble' is not a unit": (path, {"columns": {"q": {"unit": "wibble"}}}),
        "measured.time.unit: 'm' cannot be converted": (path, {"time": {"unit": "m"}}),
        "measured.columns.w: 'w' is neither a state nor an input": (path, {"columns": {"w": {"column": "q"}}}),
        "no column 'position'": (path, {"columns": {"q": {"column": "position"}}}),
        "no time column 'time'": (path, {"time": {"column": "time"}}),
        "measured.window_s: no trace is as long as a window of 9 s": (path, {"window_s": 9.0}),
        "measured.columns.q.offset": (path, {"columns": {"q": {"offset": "import os"}}}),
        "measured.columns.v.constant: a state cannot be constant": (path, {"columns": {"v": {"constant": 0.0}}}),
        "measured.held_out.files": (path, {"held_out": {"files": ["other.csv"]}}),
        "run.csv: row 2, column 'q': ": (path, {"columns": {"q": {"scale": 1e300}}}),
        "is no reading. Correct the cell, or unit, scale and offset under measured.columns.q": (
            path,
            {"columns": {"q": {"scale": 1.79e308, "unit": "deg"}}},
        ),
        "measured.noise.u": (path, {"noise": {"u": 1.0}}),
    }
    for expected, (file, section) in cases.items():
        assert expected in refusal(file, **section)


def test_files_that_are_not_recordings(tmp_path):
    data = swing()
    one = {k: v[:1] for k, v in data.items()}
    assert "has one row" in refusal(write(tmp_path / "one.csv", one))
    assert "no rows" in refusal(write(tmp_path / "none.csv", {k: v[:0] for k, v in data.items()}))
    (tmp_path / "empty.csv").write_text("")
    assert "is empty" in refusal(tmp_path / "empty.csv")
    np.savetxt(tmp_path / "bare.csv", np.ones((9, 3)), delimiter=",")
    assert "no header" in refusal(tmp_path / "bare.csv")
    (tmp_path / "ragged.csv").write_text("t,q,u\n0,1,2\n1,2\n")
    assert "row 2 has 2 cells where the header has 3" in refusal(tmp_path / "ragged.csv")
    (tmp_path / "commas.csv").write_text("t,q,u\n0,0,1,5,2,25\n0,1,1,6,2,5\n")
    assert "semicolons" not in refusal(tmp_path / "ragged.csv")
    assert "put semicolons between columns" in refusal(tmp_path / "commas.csv")
    (tmp_path / "sheet.csv").write_bytes(b"PK\x03\x04\x14\x00\xff\xfe")
    assert "is a spreadsheet, not text" in refusal(tmp_path / "sheet.csv")
    (tmp_path / "twice.csv").write_text("t,q,q\n0,1,2\n")
    assert "two columns named 'q'" in refusal(tmp_path / "twice.csv")
    assert "none of its columns" in refusal(write(tmp_path / "other.csv", {"t": data["t"], "a": data["q"]}))
    assert "has no column 't'" in refusal(write(tmp_path / "time.csv", data), columns={"q": {"column": "t"}})
    assert "no column for the input 'u'" in refusal(write(tmp_path / "free.csv", {"t": data["t"], "q": data["q"]}))
    still = {**data, "t": np.zeros(N)}
    assert "all rows have one time stamp" in refusal(write(tmp_path / "still.csv", still))
    pq.write_table(pa.table(data), tmp_path / "whole.parquet")
    (tmp_path / "half.parquet").write_bytes((tmp_path / "whole.parquet").read_bytes()[:-200])
    assert "not a whole Parquet file" in refusal(tmp_path / "half.parquet")
    (tmp_path / "latin.csv").write_bytes("t,q,u,größe\n0,1,2,3\n".encode("latin-1"))
    assert "not UTF-8" in refusal(tmp_path / "latin.csv")
