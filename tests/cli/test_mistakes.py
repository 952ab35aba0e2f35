"""What a person gets wrong is one line with file, key and remedy, and status 2; nothing half-written is left."""

import numpy as np
import pytest

from simgap.cli import main

FREE = """\
name: bench
plant:
  states: {q: {unit: rad}, v: {unit: rad/s}}
  symbolic:
    dynamics: {q: v, v: -10*sin(q)}
"""


def line_of(capsys, *arguments):
    """The one line that a mistake gives."""
    with pytest.raises(SystemExit) as left:
        main([str(a) for a in arguments])
    said = capsys.readouterr().err.strip().splitlines()
    assert left.value.code == 2, said
    (line,) = [row for row in said if row.startswith("simgap: ")]
    assert "Traceback" not in " ".join(said)
    return line


@pytest.fixture
def bench(tmp_path):
    (tmp_path / "bench.yaml").write_text(FREE)
    return tmp_path


def recording(path, interval):
    """Ten seconds, sampled every 10 ms, whose stamps are multiples of `interval` as read."""
    t = np.arange(1000)
    rows = np.column_stack([interval * t, np.cos(0.03 * t)])
    np.savetxt(path, rows, delimiter=",", header="t,q", comments="", fmt="%.9g")
    return path


@pytest.mark.parametrize(("unit", "interval"), [("ms", 10.0), ("us", 1e4), ("ns", 1e7)])
def test_stamps_in_a_shorter_unit_than_said(bench, capsys, unit, interval):
    data = recording(bench / "run.csv", interval)
    line = line_of(capsys, "diagnose", bench / "bench.yaml", data, "--out", bench / "out")
    assert f"{data}: measured.time.unit: the stamps look like {unit} and are read as s" in line
    assert "100 samples a second for 9.99 s" in line
    assert f"`time: {{unit: {unit}}}`" in line
    assert not (bench / "out").exists()


def test_stamps_that_are_slow_in_the_unit_that_is_said(bench, capsys):
    (bench / "bench.yaml").write_text(FREE + "measured: {time: {unit: min}}\n")
    line = line_of(capsys, "diagnose", bench / "bench.yaml", recording(bench / "a.csv", 0.01))
    assert "measured.time.unit: the stamps are 0.6 s apart (read in min)" in line
    assert "set measured.window_s to 4.8 or more" in line


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/out"])
def test_an_output_that_cannot_be_written_is_told_before_the_work(bench, capsys, place):
    (bench / "file").write_text("kept")
    data = recording(bench / "run.csv", 0.01)
    line = line_of(capsys, "diagnose", bench / "bench.yaml", data, "--out", bench / place)
    assert ": --out: " in line
    assert "Give another place." in line or "Choose a location that you can write to." in line
    assert (bench / "file").read_text() == "kept"


def test_a_folder_where_a_file_is_to_be_written(vary, tmp_path, capsys):
    case = vary("pendulum", {})
    line = line_of(capsys, "fresh", case, "--out", tmp_path)
    assert line == f"simgap: {tmp_path}: --out: is a folder, a file is to be written. Give another name."


def test_a_folder_for_a_recording(bench, capsys):
    assert ": is a folder, not a file. " in line_of(capsys, "diagnose", bench / "bench.yaml", bench)


@pytest.mark.parametrize("stage", ["check", "effects", "rollouts", "fresh", "borders", "synthesis"])
def test_a_wrong_joint_in_any_stage(vary, tmp_path, capsys, stage):
    case = vary("pendulum", {"plant.states.x2.joint": "elbow", "grid.eps": 0.1, "gap.fresh_samples": 100})
    options = {
        "rollouts": ["--grid", tmp_path / "grid", "--out", tmp_path / "r.parquet"],
        "synthesis": ["--out", tmp_path / "c.npz", "--summary", tmp_path / "s.json"],
    }.get(stage, [] if stage in ("check", "effects") else ["--out", tmp_path / "made.parquet"])
    if stage == "rollouts":
        with pytest.raises(SystemExit):
            main(["grid", str(case), "--out", str(tmp_path / "grid")])
        capsys.readouterr()
    line = line_of(capsys, stage, case, *options)
    told = "plant.states.x2.joint: pendulum.urdf has no moving joint 'elbow'. Moving joints: hinge."
    assert line == f"simgap: {case}: {told}"
    assert not list(tmp_path.glob("*.parquet"))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("simulator.engine", "gazebo", "no engine is called 'gazebo'. Known: pybullet,"),
        ("name", "Prüfstand", "'Prüfstand' is not a valid case name"),
        ("title", 3, "title: a text is needed, got 3. Write a word or a text"),
        ("grid.eps", "big", "grid.eps: a number is needed, got 'big'. Write a number such as 0.5."),
        ("grid.eps", -1, "grid.eps: the number must be above 0, not -1. Give one that is above 0."),
        ("synthesis.cells", "many", "synthesis.cells: a list is needed, got 'many'. Write [a, b, ...]."),
        ("plant.states", "x1", "plant.states: keys with values are needed, got 'x1'."),
        ("plant.integrator", "euler", "plant.integrator: there is no choice 'euler'. Known: explicit_euler,"),
        ("domain.tau", "5 m", "domain.tau: 'm' is not a unit that converts to s; write it like '0.005 s'"),
        ("gap.basis", ["x1", "x9", 1], "gap.basis: 'x9' names 'x9', which is not known. Known: u, x1, x2."),
        ("plant.effects", [{"name": "rust", "on": "hinge", "parameters": {"b": 1}}], "plant.effects.0.name: there is"),
        ("plant.states.x1.unit", "deg", "plant.states.x1.unit: the unit is 'deg', but this is computed in"),
        ("grid.eps", 1e-9, "grid.eps: 5,000,000,015,039,489,150 samples of X x U need"),
        ("synthesis.cells", [1000000, 1000000], "synthesis.cells: 25,000,000,000,000 pairs of cell and input for each"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_told_in_words(vary, capsys, key, value, words):
    case = vary("pendulum", {key: value})
    line = line_of(capsys, "check", case)
    assert line.startswith(f"simgap: {case}: ")
    assert words in line
    assert "Input should" not in line
    assert "type=" not in line


def test_a_run_without_a_case_is_one_line(bench, capsys, monkeypatch):
    monkeypatch.chdir(bench)
    assert "no case is given" in line_of(capsys, "run", "--dry-run")
    assert "Did you mean --cores? Name one or more case files" in line_of(capsys, "run", "--coers", "2")
    assert "Missing parameter: case, such as simgap diagnose robot.yaml" in line_of(capsys, "diagnose")


def test_every_misspelt_key_is_named(tmp_path, capsys):
    path = tmp_path / "a.yaml"
    path.write_text("name: a\nplnat: {}\ngrdi: {}\nplant: {urdf: a.urdf, stats: {}, inputs: {}}\n")
    assert "Also wrong: plnat, grdi, plant.states." in line_of(capsys, "check", str(path))
