"""Recordings in JSON: the shapes that are read, what is refused in one line, and damage that does nothing else."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simgap.errors import UserError
from simgap.io.recordings.tables import read_header, read_recording

N = 40
T = 0.005 * np.arange(N)
Q = np.sin(7 * T)
ENTRIES = [
    {"t": t, "q": q, "torque_enable": k % 2 == 0, "note": "free", "state": {"temp": 30 + k}, "goal": [q, -q]}
    for k, (t, q) in enumerate(zip(T.tolist(), Q.tolist(), strict=True))
]
BENCH = {"mass": 1.5, "kp": 32, "motor": "servo", "bus": {"volts": 12.1}, "pid": [32, 0, 0], "entries": ENTRIES}
SHAPES = {
    "list.json": json.dumps(ENTRIES),
    "arrays.json": json.dumps(
        {"t": T.tolist(), "q": Q.tolist(), "torque_enable": [e["torque_enable"] for e in ENTRIES]}
    ),
    "bench.json": json.dumps(BENCH, indent=2),
    "lines.jsonl": "\n".join(map(json.dumps, ENTRIES)) + "\n\n",
    "lines.json": "\r\n".join(map(json.dumps, ENTRIES)),
    "bench.log": "\n " + json.dumps(BENCH),
    "bench.jsonl": json.dumps(BENCH),
    "printed.jsonl": json.dumps(BENCH, indent=2),
}


def written(folder, text, name="run.json"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read(path, *wanted, time="t", trace="trace"):
    return read_recording(path, wanted, time, trace, path.name)


@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_gives_the_same_columns(tmp_path, name, start):
    path = written(tmp_path, start + SHAPES[name].encode(), name)
    raw = read(path, "q", "torque_enable", "absent")
    assert (raw.rows, raw.labels, raw.time_unit) == (N, None, None)
    assert list(raw.time) == T.tolist()
    assert set(raw.columns) == {"q", "torque_enable"}
    assert list(raw.columns["q"]) == Q.tolist()
    assert list(raw.columns["torque_enable"]) == [1.0, 0.0] * (N // 2)
    assert read_header(path, name) == (raw.header, {})


def test_what_stands_beside_the_samples_is_a_column_and_what_is_nested_has_a_dotted_name(tmp_path):
    path = written(tmp_path, SHAPES["bench.json"])
    raw = read(path, "mass", "bus.volts", "state.temp", "goal.1", "kp", trace="motor")
    assert raw.header == (
        "t", "q", "torque_enable", "note", "state.temp", "goal.0", "goal.1", "mass", "kp", "motor", "bus.volts",
    )  # fmt: skip
    assert list(raw.columns["mass"]) == [1.5] * N
    assert list(raw.columns["bus.volts"]) == [12.1] * N
    assert list(raw.columns["state.temp"]) == [30.0 + k for k in range(N)]
    assert list(raw.columns["goal.1"]) == (-Q).tolist()
    assert list(raw.labels) == ["servo"] * N


def test_whole_stamps_stay_exact(tmp_path):
    stamps = [1_700_000_000_000_000_001 + 5_000_000 * k for k in range(5)]
    raw = read(written(tmp_path, json.dumps({"t": stamps, "q": [0, 1, 2, 3, 4]})), "q")
    assert raw.time.tolist() == stamps


def test_a_utf_16_file_is_read(tmp_path):
    assert read(written(tmp_path, SHAPES["list.json"].encode("utf-16")), "q").rows == N


REFUSED = {
    "nothing": ("", r"run\.json: is empty"),
    "cut off": (SHAPES["bench.json"][:700], r"run\.json: ends at line \d+ before its JSON does. Wait until"),
    "malformed": ('[{"t": 0, "q": 1},\n {"t": 1; "q": 2}]', r"line 2, column 9 is not JSON .*Correct it there"),
    "malformed line": ('{"t": 0, "q": 1}\n{"t": 1, "q" 2}\n', r"line 2, column 14 is not JSON"),
    "a number": ("3.5", r"the document is a number, not an object.*a list of objects"),
    "a list of numbers": ("[1, 2]", r"row 1 is a number, not an object"),
    "lines of lists": ("[0, 1]\n[1, 2]\n", r"line 1 is a list, not an object"),
    "scalars alone": ('{"mass": 1.5, "bus": {"volts": 12}}', r"holds no list of samples"),
    "no samples": ('{"mass": 1.5, "entries": []}', r"has no samples"),
    "an empty list": ("[]", r"has no samples"),
    "two lists": ('{"a": [{"t": 0}], "b": [{"t": 0}]}', r"two lists of samples, 'a' and 'b'.*a file of its own"),
    "lengths": ('{"t": [0, 1, 2], "q": [0, 1]}', r"'q' has 2 values and 't' 3.*arrays of one length"),
    "key twice": ('[{"t": 0, "q": 1}, {"t": 1, "q": 2, "q": 3}]', r"the key 'q' appears twice"),
    "key twice beside": ('{"m": 1, "m": 2, "entries": [{"t": 0}]}', r"the key 'm' appears twice"),
    "key twice below": ('[{"t": 0, "q": {"a": 1, "a": 2}}]', r"the key 'a' appears twice"),
    "dotted twice": ('[{"t": 0, "q": 1, "a": {"b": 1}, "a.b": 2}]', r"row 1: two values are called 'a\.b'"),
    "in and beside": ('{"q": 1, "entries": [{"t": 0, "q": 1}]}', r"'q' appears in the samples and beside them"),
    "no time": ('[{"time": 0, "q": 1}]', r"no time column 't' among 'time', 'q'.*measured\.time\.column"),
    "text": ('[{"t": 0, "q": 1}, {"t": 1, "q": "1.5"}]', r"row 2, key 'q': '1\.5' is a text, not a number"),
    "text beside": ('{"q": "none", "entries": [{"t": 0}]}', r"row 1, key 'q': 'none' is a text"),
    "no stamp": (
        '[{"t": 0, "q": 1}, {"t": null, "q": 1}]',
        r"row 2, key 't': null is not a reading.*leave the sample out",
    ),
    "missing": ('[{"t": 0, "q": 1}, {"t": 1}]', r"row 2, key 'q': the sample has no such key"),
    "missing line": ('{"t": 0, "q": 1}\n\n{"t": 1}\n', r"row 2, key 'q': the sample has no such key"),
    "Infinity": ('{"t": [0, -Infinity], "q": [1, 2]}', r"row 2, key 't': '-inf' is not a finite number"),
    "too large": ('[{"t": 0, "q": 1e400}]', r"row 1, key 'q': 'inf' is not a finite number"),
    "a large whole number": ('[{"t": 0, "q": 1%s}]' % ("0" * 400), r"row 1, key 'q': '1000.*0' is not a finite"),
    "thousands of digits": ('[{"t": 0, "q": %s}]' % ("9" * 5000), r"an integer of thousands of digits"),
    "deep": ('{"a":' * 100_000, r"is nested too deeply"),
    "deep lists": ("[" * 100_000, r"is nested too deeply"),
    "bytes": (b'[{"t": 0, "q": "\xff\xfe"}]', r"is not UTF-8 text"),
    "packed": (b"\x1f\x8b\x08\x00" + bytes(range(128, 250)), r"is compressed \(gzip\).*gunzip"),
    "trace": ('[{"t": 0, "q": 1, "trace": null}]', r"row 1, key 'trace': null is not a reading"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_one_short_line(tmp_path, name):
    text, match = REFUSED[name]
    with pytest.raises(UserError, match=match) as caught:
        read(written(tmp_path, text), "q")
    told = str(caught.value)
    assert told.startswith("run.json: ")
    assert told.isprintable()
    assert len(told) < 300


def test_what_is_not_needed_may_be_anything(tmp_path):
    text = '[{"t": 0, "q": 1, "a": NaN, "b": null, "c": "x", "\\ud800": 1}, {"t": 1, "q": 2, "a": 1e999}]'
    raw = read(written(tmp_path, text), "q")
    assert list(raw.columns["q"]) == [1.0, 2.0]
    "".join(raw.header).encode()


@pytest.mark.parametrize("name", ["run.json", "run.jsonl"])
def test_what_would_not_fit_into_memory_is_refused(tmp_path, monkeypatch, name):
    path = written(tmp_path, SHAPES["list.json" if name == "run.json" else "lines.jsonl"], name)
    monkeypatch.setattr("simgap.reading.MOST", 100_000)
    if name == "run.json":
        with pytest.raises(UserError, match=r"run\.json: holds .* GB unpacked.*lines of JSON"):
            read(path, "q")
    else:  # a line at a time
        assert read(path, "q").rows == N


SCALARS = st.sampled_from(["1", "0.5", "1e400", "NaN", "null", "true", '"x"', "[]", "{}", "[1]", '{"q": 1}', "9" * 30])
WORDS = st.sampled_from([*'[]{}",:', '"t"', '"q"', "\n", "\x00", "\u2028", "\\ud800", '"q": 1,', "  "])


@settings(max_examples=150, derandomize=True, deadline=None, database=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@given(
    shape=st.sampled_from(["list.json", "arrays.json", "bench.json", "lines.jsonl"]),
    edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), SCALARS | WORDS | st.text(max_size=4)), max_size=3),
)
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path, shape, edits):
    text = SHAPES[shape]
    for where, length, word in edits:
        at = int(where * len(text))
        text = text[:at] + word + text[at + length :]
    path = tmp_path / shape
    path.write_bytes(text.encode(errors="surrogatepass"))
    try:
        raw = read(path, "q", "torque_enable")
    except UserError as error:
        told = str(error)
        assert told.isprintable()
        assert len(told) < 400
    else:
        assert all(np.isfinite(values).all() and len(values) == raw.rows for values in raw.columns.values())
