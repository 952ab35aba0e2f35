"""What is said of the columns of recordings: renamed, unknown, and the states that are then not measured."""

import numpy as np

from simgap.diagnosis.record.channels import Channel, RawTable, column_words

Q, V, U = Channel("q", "rad", False, "q"), Channel("v", "rad/s", False, "v"), Channel("u", "N*m", True, "u")
ANGLE = Channel("q", "rad", False, "angle", column_unit="deg", mapped=True)
OTHERS = ("t", "trace")


def table(*header, file="a.csv"):
    return RawTable(file, header, np.zeros(2), None, {}, None, {}, "")


def test_columns_that_are_named_as_in_the_case_are_not_told():
    assert column_words([table("t", "q", "v", "u", "trace")], (Q, V, U), OTHERS) == ()
    assert column_words([table("t", "q", "u")], (Q, V, U), OTHERS) == ()  # velocities are seldom measured


def test_a_column_that_the_case_renames_is_told():
    assert column_words([table("t", "angle", "v", "u")], (ANGLE, V, U), OTHERS) == ("Columns: q is read from 'angle'.",)


def test_a_column_that_is_unknown_is_told_with_the_state_that_it_may_be():
    (said,) = column_words([table("t", "winkel", "v", "u")], (Q, V, U), OTHERS)
    assert "'winkel' is not used, as the model has no such state or input" in said
    assert "q counts as not measured (name a column that is it under measured.columns)" in said


def test_files_that_differ_are_told_apart_and_alike_ones_once():
    alike = [table("t", "q", "v", "u", "temperature", file=name) for name in ("a.csv", "b.csv")]
    assert len(column_words(alike, (Q, V, U), OTHERS)) == 1
    (said,) = column_words([table("t", "q", "v", "u"), alike[1]], (Q, V, U), OTHERS)
    assert said.startswith("Columns of b.csv: 'temperature' is not used")


def test_a_long_list_is_cut_between_names():
    (said,) = column_words([table("t", "q", "v", "u", *(f"current_desired{k}" for k in range(20)))], (Q, V, U), OTHERS)
    listed = said.removeprefix("Columns: ").split(" and ")[0].split(", ")
    assert listed == [f"'current_desired{k}'" for k in range(len(listed))]
    assert f"and {20 - len(listed)} more are not used" in said
