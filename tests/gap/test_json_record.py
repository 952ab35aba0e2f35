"""Records that write and read themselves, against the JSON that stands here by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from simgap.arrays import Floats, Ints
from simgap.gap.json_record import JsonRecord


@dataclass(frozen=True, eq=False)
class Part(JsonRecord, names={"level": "tier"}):
    level: int
    rows: Ints


@dataclass(frozen=True, eq=False)
class Whole(JsonRecord, kind="whole", program="none"):
    terms: tuple[str, ...]
    table: Floats
    parts: dict[str, Part]
    box: Floats | None = None


JSON = {
    "kind": "whole", "program": "none", "terms": ["1", "x"], "table": [[0.5, 1.0]],
    "parts": {"upper": {"tier": 2, "rows": [1, 2]}}, "box": None,
}  # fmt: skip


def test_a_record_writes_its_constants_first_and_its_fields_in_their_order():
    whole = Whole(("1", "x"), np.array([[0.5, 1.0]]), {"upper": Part(2, np.array([1, 2]))})
    assert list(whole.to_json().items()) == list(JSON.items())


def test_a_record_is_read_back_with_the_types_of_its_fields():
    whole = Whole.from_json(JSON | {"box": [1, 2]})
    part = whole.parts["upper"]
    assert (whole.terms, part.level, part.rows.tolist(), part.rows.dtype) == (("1", "x"), 2, [1, 2], np.int64)
    assert (whole.table.tolist(), whole.box.tolist(), whole.box.dtype) == ([[0.5, 1.0]], [1.0, 2.0], np.float64)


@pytest.mark.parametrize(
    ("broken", "error"),
    [
        ({"terms": 1}, TypeError),
        ({"table": [["a"]]}, ValueError),
        ({"table": [[1], [1, 2]]}, ValueError),
        ({"parts": {"upper": {}}}, KeyError),
    ],
)
def test_what_is_no_record_is_refused(broken, error):
    with pytest.raises(error):
        Whole.from_json(JSON | broken)
