"""What a case says wrongly of its recordings is told by `simgap check`, with the case's own file, key and remedy."""

import copy
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from simgap.config.measured import MeasuredSection, named_recordings
from simgap.errors import UserError
from simgap.lint.measured import check_measured, refuse_links
from simgap.plants.context import Context
from simgap.stages import check, diagnosis

BALL = {
    "name": "ball",
    "plant": {
        "states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}},
        "inputs": {"a": {"unit": "rad"}},
        "symbolic": {
            "parameters": {"g": {"value": 9.81, "unit": "m/s^2"}, "m": {"value": 0.1, "unit": "kg"}},
            "dynamics": {"x": "v", "v": "5/7*g*sin(a)"},
            "coordinates": {"beam": {"position": "x", "velocity": "v", "force_gain": "5/(7*m)"}},
        },
    },
    "measured": {
        "files": ["run.csv"],
        "time": {"column": "t_ms", "unit": "ms"},
        "columns": {"x": {"column": "ball", "unit": "mm"}, "a": {"column": "servo", "unit": "deg"}},
    },
}


@pytest.fixture
def ball(tmp_path):
    """A case with a changed `measured` section beside a recording in mm, degrees and ms: -> path."""
    t = np.arange(500)
    rows = np.column_stack([10.0 * t, 100.0 * np.cos(0.03 * t), 3.0 * np.sin(0.1 * t)])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="t_ms,ball,servo", comments="", fmt="%.9g")

    def make(**changes):
        content = copy.deepcopy(BALL)
        content["measured"] |= changes
        path = tmp_path / "ball.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return make


def columns(**changes):
    return {"columns": BALL["measured"]["columns"] | changes}


WRONG = [
    ({"files": ["run.csv", "runs/*.csv"]}, "files.1", "there is no file: 'runs/*.csv'", "starts from the folder"),
    ({"files": ["run.csv", "gone.csv"]}, "files.1", "there is no file: 'gone.csv'", "starts from the folder"),
    (columns(x={"column": "ball", "unit": "deg"}), "columns.x.unit", "'deg' cannot be converted to 'm'", "like 'm'"),
    (columns(x={"column": "ball", "unit": "milimetre"}), "columns.x.unit", "'milimetre' is not a unit", "Write units"),
    (columns(x={"column": "bal", "unit": "mm"}), "columns.x.column", "'run.csv' has no column 'bal'", "Name one"),
    (columns(w={"column": "ball"}), "columns.w", "'w' is neither a state nor an input", "Known: x, v, a"),
    (columns(x={"column": "ball", "unit": "mm", "wrapped": True}), "columns.x.wrapped", "'mm' is not an angle", "Rem"),
    (columns(x={"column": "ball", "unit": "mm", "offset": "pie"}), "columns.x.offset", "'pie'", "Write a number"),
    (columns(x={"constant": 0.0}), "columns.x.constant", "a state cannot be constant", "Leave out"),
    ({"time": {"column": "time"}}, "time.column", "'run.csv' has no time column 'time', it has", "Name its column"),
    ({"time": {"column": "t_ms", "unit": "m"}}, "time.unit", "'m' cannot be converted to 's'", "Use s, ms"),
    ({"noise": {"y": 0.1}}, "noise.y", "'y' is not a state", "Known: x, v"),
    ({"effects": ["viscous_frictoin"]}, "effects.0", "there is no effect", "Did you mean 'viscous_friction'?"),
    ({"conditions": [{"file": "run.csv", "M": 1.0}]}, "conditions.0", "'M' is not a parameter of the", "Known: g, m"),
    ({"conditions": [{"file": "run2.csv", "m": 1.0}]}, "conditions.0.file", "'run2.csv' is not among", "Name one"),
    ({"held_out": {"files": ["other.csv"]}}, "held_out.files.0", "'other.csv' is not among", "Name one of run.csv"),
    ({"masks": [{"file": "rn.csv", "drop": [0, 1]}]}, "masks.0.file", "'rn.csv' is not among", "Name one of run.csv"),
    ({"payloads": [{"file": "run.csv", "link": "tip"}]}, "payloads", "on arms of three joints or more", "Remove them"),
]  # fmt: skip


def test_a_section_that_is_right_passes(ball):
    checked = check.run(ball())
    assert checked.costs == []
    assert checked.recordings == ["run.csv: 500 rows; t_ms in ms, x from ball in mm, a from servo in deg"]


@pytest.mark.parametrize(
    ("changes", "key", "problem", "remedy"), WRONG, ids=[w[1] + str(k) for k, w in enumerate(WRONG)]
)
def test_check_refuses_it_and_so_does_diagnose(ball, tmp_path, changes, key, problem, remedy):
    path = ball(**changes)
    for stage in (lambda: check.run(path), lambda: diagnosis.run(path, [], tmp_path / "out")):
        with pytest.raises(UserError) as caught:
            stage()
        assert (str(caught.value.file), caught.value.key) == (str(path), f"measured.{key}")
        assert problem in caught.value.problem
        assert remedy in caught.value.remedy
    assert not (tmp_path / "out").exists()


def test_an_input_that_no_column_holds_is_refused(ball):
    path = ball(columns={"x": {"column": "ball", "unit": "mm"}})
    with pytest.raises(UserError, match=r"no column for the input 'a' among .* Map it with measured\.columns\.a"):
        check.run(path)


def test_the_unit_that_a_parquet_file_stores_counts(ball, tmp_path):
    fields = [pa.field("t_ms", pa.float64()), pa.field("ball", pa.float64(), metadata={"unit": "kg"})]
    fields.append(pa.field("servo", pa.float64()))
    table = pa.table([[0.0, 10.0], [1.0, 2.0], [0.0, 0.0]], schema=pa.schema(fields))
    pq.write_table(table, tmp_path / "run.parquet")
    path = ball(files=["run.parquet"], **columns(x={"column": "ball"}))
    with pytest.raises(UserError, match=r"run\.parquet: column 'ball': 'kg' cannot be converted to 'm'"):
        check.run(path)


def test_a_pattern_stands_for_the_files_that_match_it_in_the_order_of_their_names(ball, tmp_path):
    """Each file once, whatever names bring it; a file whose own name looks like a pattern is that file."""
    (tmp_path / "runs").mkdir()
    for name in ("b", "a", "c[1]"):
        (tmp_path / "runs" / f"{name}.csv").write_bytes((tmp_path / "run.csv").read_bytes())
    context = Context.load(ball(files=["runs/b.csv", "runs/*.csv", "runs/c[1].csv", "run.csv"]))
    check_measured(context)
    assert context.case.measured is not None
    found = named_recordings(context.path, context.case.measured.files)
    assert [p.relative_to(tmp_path).as_posix() for p in found] == [
        "runs/b.csv", "runs/a.csv", "runs/c[1].csv", "run.csv"
    ]  # fmt: skip


@pytest.mark.parametrize("said", [{"conditions": [{"file": "run.csv", "m": 1.0}]}, {"conditions_from": {"m": "mass"}}])
def test_an_arm_of_many_joints_takes_no_conditions(said):
    arm = SimpleNamespace(plant=SimpleNamespace(declared=SimpleNamespace(derived=False), tree=object()))
    refuse_links(arm, MeasuredSection())
    with pytest.raises(UserError, match=r"knows no such conditions.*measured\.payloads") as caught:
        refuse_links(arm, MeasuredSection.model_validate(said))
    assert caught.value.key == f"measured.{next(iter(said))}"


def test_it_is_told_that_no_force_is_sought_where_nothing_says_what_moves(ball):
    path = ball()
    assert "plant.symbolic.coordinates" not in [f.key for f in check.run(path).findings]
    content = yaml.safe_load(path.read_text())
    del content["plant"]["symbolic"]["coordinates"]
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    assert not check.run(path).findings  # one position and its velocity: they show what moves
    content["plant"]["symbolic"]["dynamics"]["x"] = "1.0*v"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    (found,) = check.run(path).findings
    assert found.key == "plant.symbolic.coordinates"
    assert "seeks no friction" in found.problem
