"""Seeded random damage to what people and programs hand in: it is read, or refused by one short UserError."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.io.results import read_json, write_json
from simgap.model.expressions import parse
from simgap.plants.model_file import read_model_file
from simgap.plants.urdf_checks import check_urdf

ROOT = Path(__file__).parents[2]
CASE = (ROOT / "configs/cases/dfki_pendulum.yaml").read_text()
URDF = (ROOT / "configs/models/pendulum.urdf").read_text()


def seeded(count):
    slow = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.filter_too_much]
    return settings(max_examples=count, derandomize=True, deadline=None, database=None, suppress_health_check=slow)


def only_user_errors(path, call):
    """What the call gives; None where it refuses, in one short line of characters that can be printed."""
    try:
        return call()
    except UserError as error:
        told = str(error).replace(str(path.parent), "")
    assert told.isprintable()
    assert len(told) < 1500
    return None


WORDS = st.sampled_from(
    ["1", "-1", "0", "1e400", ".inf", ".nan", "~", "[]", "{}", "[[1]]", "&a", "*a", "<<: *a", "!!set", "!!binary x",
     "- ", ": ", "? ", "x: 1", "{a: 1, a: 2}", "2024-13-45", "\x00", "\t", "\n", "#", "'", '"', "|", ">", "%", "@",
     "١٢", "9" * 400, "--- ", "on", "yes", "name", "plant", "extends: x.yaml", "../../etc", "$(touch x)", "\u202e",
     "\U0001f600"]
)  # fmt: skip
EDITS = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 12), st.one_of(WORDS, st.text(max_size=8))), min_size=1, max_size=4
)


def damaged(text, edits):
    for where, length, word in edits:
        at = int(where * len(text))
        text = text[:at] + word + text[at + length :]
    return text


@seeded(250)
@given(edits=EDITS)
def test_a_damaged_case(tmp_path, edits):
    path = tmp_path / "case.yaml"
    path.write_bytes(damaged(CASE, edits).encode(errors="surrogatepass"))
    found = only_user_errors(path, lambda: load_case(path))
    assert found is None or found == load_case(path)


@seeded(250)
@given(edits=EDITS)
def test_a_damaged_urdf(tmp_path, edits):
    path = tmp_path / "model.urdf"
    path.write_bytes(damaged(URDF, edits).encode(errors="surrogatepass"))
    found = only_user_errors(path, lambda: (check_urdf(path), read_model_file(path))[1])
    assert found is None or found.links


LEAVES = st.sampled_from(
    ["x", "y", "pi", "1", "0", "-1", "2.5", "1e300", "1e-300", "1e400", "9", "z", "()", "True", "'x'", "9" * 320, "٣"]
)
EXPRESSIONS = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "^", "**", "//", "%", " "]), inner).map("".join),
        st.tuples(
            st.sampled_from(["sin", "tan", "log", "sqrt", "abs", "sign", "exp", "atan", "tanh", "eval"]), inner
        ).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(st.sampled_from(["min", "max"]), st.lists(inner, max_size=3)).map(
            lambda t: f"{t[0]}({','.join(t[1])})"
        ),
        inner.map(lambda e: f"({e})"),
        inner.map(lambda e: f"-{e}"),
    ),
    max_leaves=12,
)


@seeded(300)
@given(text=st.one_of(EXPRESSIONS, st.text(max_size=20)))
def test_an_expression(tmp_path, text):
    found = only_user_errors(tmp_path / "x", lambda: parse(text, ["x", "y"]))
    if found is not None and found.is_number:
        assert math.isfinite(float(found))


PLAIN = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text(max_size=5)
    ),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=4)),
    max_leaves=15,
)


@seeded(200)
@given(content=st.dictionaries(st.text(max_size=5).filter(lambda k: k != "checksum"), PLAIN, max_size=5))
def test_a_result_reads_back_as_it_was_written(tmp_path, content):
    write_json(tmp_path / "a.json", content)
    assert read_json(tmp_path / "a.json") == content


RESULT = {
    "kind": "linear",
    "eps": 0.0056,
    "gap": {"x1": {"upper": {"offset": 7.6e-7, "terms": ["x", "1"]}}},
    "fresh": [1, 2],
}


@seeded(400)
@given(edits=EDITS)
def test_a_damaged_result_is_refused_or_the_same(tmp_path, edits):
    path = tmp_path / "a.json"
    write_json(path, RESULT)
    path.write_bytes(damaged(path.read_text(), edits).encode(errors="surrogatepass"))
    found = only_user_errors(path, lambda: read_json(path))
    assert found is None or found == RESULT


@seeded(400)
@given(bit=st.floats(0, 1, exclude_max=True))
def test_a_flipped_bit_of_a_result_is_refused_or_changes_nothing(tmp_path, bit):
    path = tmp_path / "a.json"
    write_json(path, RESULT)
    data = bytearray(path.read_bytes())
    place = int(bit * 8 * len(data))
    data[place // 8] ^= 1 << (place % 8)
    path.write_bytes(data)
    found = only_user_errors(path, lambda: read_json(path))
    assert found is None or found == RESULT


@seeded(100)
@given(text=st.one_of(st.text(max_size=30), PLAIN.map(json.dumps)))
def test_what_is_no_result_is_refused(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(UserError, match="damaged"):
        read_json(path)
