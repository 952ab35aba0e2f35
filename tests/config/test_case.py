"""Case files: the shipped ones check, mistakes are one line with file, key and remedy."""

import json

import jsonschema
import pytest

from simgap.cli import main
from simgap.config.case import schema_text
from simgap.config.load import load_case, read_yaml
from simgap.config.measured import MeasuredSection
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.stages.reference import reference


def shipped(root):
    return sorted((root / "configs" / "cases").glob("*.yaml"))


def test_shipped_cases_check_against_models_and_schema(root):
    schema = json.loads(schema_text())
    for path in shipped(root):
        assert load_case(path).name == path.stem
        jsonschema.validate(json.loads(json.dumps(read_yaml(path))), schema)


def test_the_schema_file_is_what_the_sections_say(root):
    assert (root / "configs" / "schema.json").read_text() == schema_text(), "run `simgap schema`"


def test_the_reference_is_what_sections_and_effects_say(root):
    pages = reference()
    for name, text in pages.items():
        assert (root / "docs/reference" / name).read_text() == text, "run `simgap reference`"
    text = "".join(pages.values())
    assert "`domain.U.<name>.step` | number > 0" in text
    assert "`measured.columns.<name>.unit`" in text


def test_a_bare_name_is_that_of_a_column():
    short = MeasuredSection.model_validate({"columns": {"q": "angle"}, "time": "stamp"})
    assert short == MeasuredSection.model_validate({"columns": {"q": {"column": "angle"}}, "time": {"column": "stamp"}})


def test_a_case_extends_another_section_by_section(vary):
    base = vary("pendulum", {"gap.fresh_samples": 77})
    path = base.with_name("other.yaml")
    path.write_text("name: other\nextends: pendulum.yaml\nsimulator: {engine: mujoco}\nmeasured: null\n")
    one, other = load_case(base), load_case(path)
    assert other.simulator.engine == "mujoco"
    assert other.measured is None
    assert one.measured is not None
    same = ("plant", "domain", "grid", "gap", "synthesis", "validation", "title")
    assert all(getattr(one, name) == getattr(other, name) for name in same)


@pytest.mark.parametrize(
    ("text", "file", "words"),
    [
        ("name: a\nextends: a.yaml\n", "a.yaml", "extends: a case cannot extend itself"),
        ("name: a\nextends: ../pendulum.yaml\n", "a.yaml", "'../pendulum.yaml' is not a case file of this folder"),
        ("name: a\nextends: nowhere.yaml\n", "nowhere.yaml", "does not exist"),
        ("name: a\nextends: broken.yaml\n", "broken.yaml", "grid.epz: unknown key"),
        ("name: a\nextend: pendulum.yaml\n", "a.yaml", "Did you mean 'extends'?"),
        ("name: a\nextends: pendulum.yaml\ngrid: {epz: 1}\n", "a.yaml", "Did you mean 'eps'?"),
    ],
)
def test_mistakes_in_what_a_case_extends(vary, text, file, words):
    base = vary("pendulum", {"grid.epz": 1})
    base.rename(base.with_name("broken.yaml"))
    path = vary("pendulum", {}).with_name("a.yaml")
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_case(path)
    assert f"/{file}: " in str(caught.value)
    assert words in str(caught.value)


def test_every_key_has_a_description():
    def walk(node, place):
        for name, field in node.get("properties", {}).items():
            assert field.get("description") or "$ref" in field, f"{place}.{name} has no description"
        for name, part in node.get("$defs", {}).items():
            walk(part, name)

    walk(json.loads(schema_text()), "case")


def test_input_steps_are_the_decimals_a_person_writes(root):
    values = load_case(root / "configs/cases/pendulum.yaml").domain.U["u"].list()
    assert values.tolist() == [round(-1.2 + 0.1 * k, 1) for k in range(25)]


MISTAKES = {
    "unknown key": ({"grid.epz": 0.1}, (), "grid.epz", "eps"),
    "missing key": ({}, ("simulator.inertia",), "inertia", "missing"),
    "wrong unit": ({"domain.tau": "0.005 kg"}, (), "domain.tau", "kg"),
    "not a number": ({"domain.tau": "soon"}, (), "domain.tau", "soon"),
    "box upside down": ({"domain.X.x1": [0.2, -0.2]}, (), "domain.X.x1", "ends are reversed"),
    "eps not positive": ({"grid.eps": 0}, (), "grid.eps", "must be above 0"),
    "empty U": ({"domain.U.u": {"values": []}}, (), "domain.U.u", "empty"),
    "U upside down": ({"domain.U.u": {"min": 1, "max": -1, "step": 0.1}}, (), "domain.U.u", "empty"),
    "step too small": ({"domain.U.u": {"min": -1, "max": 1, "step": 1e-300}}, (), "domain.U.u", "can be counted"),
    "U too wide": ({"domain.U.u": {"min": -1e308, "max": 1e308, "step": 1e308}}, (), "domain.U.u", "can be counted"),
    "state without a box": ({}, ("domain.X.x2",), "domain.X", "x2"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_one_line_with_file_and_key(vary, mistake):
    changes, removed, key, word = MISTAKES[mistake]
    path = vary("pendulum", changes, removed)
    with pytest.raises(UserError) as caught:
        load_case(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    assert key in text
    assert word in text


@pytest.mark.parametrize(("x1", "eps"), [((-1e308, 1e308), 0.1), ((-1e307, 1e307), 0.1), ((-0.2, 0.2), 1e-300)])
def test_cells_that_cannot_be_counted_are_refused(x1, eps):
    with pytest.raises(UserError, match=r"grid\.eps: .* too many to count"):
        Grid.covering(Box([x1[0], 0.0], [x1[1], 1.0]), eps)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"plant.urdf": "nowhere.urdf"}, ["nowhere.urdf", "does not exist"]),
        ({"plant.states.x1.unit": "kg"}, ["x1.unit", "kg", "rad"]),
        ({"plant.states.x1.unit": "deg"}, ["plant.states.x1.unit", "deg", "Use 'rad'"]),
        ({"synthesis.specification.safe.x1": [0.0, 0.3]}, ["safe", "0.3"]),
        ({"synthesis.specification.safe.x9": [0.0, 0.3]}, ["x9"]),
    ],
)
def test_mistakes_that_a_stage_meets_leave_status_2_and_no_file(vary, tmp_path, capsys, changes, words):
    path, out = vary("pendulum", changes), tmp_path / "out" / "controller.npz"
    with pytest.raises(SystemExit) as caught:
        main(
            [
                "synthesis",
                str(path),
                "--out",
                str(out),
                "--summary",
                str(tmp_path / "out" / "s.json"),
                "--log",
                str(tmp_path / "l"),
            ]
        )
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    wrong = path.with_name("nowhere.urdf") if "plant.urdf" in changes else path
    assert line.startswith(f"simgap: {wrong}: ")
    for word in words:
        assert word in line
    assert not list(out.parent.glob("*"))


def test_a_moving_link_without_inertia_is_refused(vary, root, tmp_path, capsys):
    text = (root / "configs/models/pendulum.urdf").read_text()
    start, end = text.index("<inertial>"), text.index("</inertial>") + len("</inertial>")
    bare = tmp_path / "bare.urdf"
    bare.write_text(text[:start] + text[end:])
    path = vary("pendulum", {"plant.urdf": str(bare)})
    with pytest.raises(SystemExit) as caught:
        main(["effects", str(path)])
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert "rod" in error
    assert "inertia" in error


def test_extends_merges_keys_and_replaces_a_section_of_another_kind(vary):
    base = vary("pendulum", {})
    path = base.parent / "other.yaml"
    path.write_text(
        "name: other\nextends: pendulum.yaml\nsimulator: {damping: {linear: 0.1}}\nsynthesis: {cells: [10, 20]}\n"
        "domain: {X: {x1: [-0.1, 0.1]}}\ngap: {basis: [1]}\n"
    )
    below, case = load_case(base), load_case(path)
    assert case.simulator.damping.linear == 0.1
    assert case.simulator.damping.angular == below.simulator.damping.angular
    assert case.simulator.inertia == "engine"
    assert case.synthesis.cells == (10, 20)
    assert case.synthesis.specification == below.synthesis.specification
    assert dict(case.domain.X) == {"x1": (-0.1, 0.1), "x2": below.domain.X["x2"]}
    assert case.domain.U == below.domain.U
    path.write_text("name: other\nextends: pendulum.yaml\nsimulator: {engine: mujoco, substeps: 2}\n")
    case = load_case(path)
    assert case.simulator.engine == "mujoco"
    assert not hasattr(case.simulator, "inertia")
    assert case.simulator.damping.angular == 0.0


def test_a_name_that_is_none_says_what_one_is(vary):
    with pytest.raises(UserError, match=r"'pändel' is not a valid case name.*Use lower-case letters a to z"):
        load_case(vary("pendulum", {"name": "pändel"}))


def test_what_the_system_refuses_is_one_line(root, tmp_path, capsys):
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    for out in (in_the_way / "schema.json", in_the_way / "more" / "schema.json"):
        with pytest.raises(SystemExit) as ended:
            main(["schema", "--out", str(out)])
        assert ended.value.code == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert f"cannot be written: {in_the_way} is not a folder" in told


def test_extends_replaces_a_range_by_values_and_a_section_by_an_empty_one(vary):
    base = vary("turtlebot", {"simulator.urdf": "x.urdf"})
    path = base.with_name("other.yaml")
    path.write_text(
        "name: other\nextends: turtlebot.yaml\ndomain: {U: {v: {values: [0, 0.5]}}}\nhidden_state: {classes: {}}\n"
    )
    case = load_case(path)
    assert case.domain.U["v"].list().tolist() == [0.0, 0.5]
    assert case.domain.U["v"].min is None
    assert case.hidden_state.classes == {}
    back = base.with_name("back.yaml")
    back.write_text("name: back\nextends: other.yaml\ndomain: {U: {v: {min: 0, max: 1, step: 0.5}}}\n")
    assert load_case(back).domain.U["v"].list().tolist() == [0.0, 0.5, 1.0]


def test_an_input_set_has_values_or_a_range(vary):
    both = {"min": 0, "max": 1, "step": 1, "values": [0, 1]}
    with pytest.raises(UserError, match="either values, or min, max and step"):
        load_case(vary("pendulum", {"domain.U": {"u": both}}))


def test_what_is_no_case_says_how_one_is_made(tmp_path):
    (tmp_path / "log.csv").write_text("t,x\n0,1\n")
    with pytest.raises(UserError, match=r"this is not a case: .*simgap new"):
        load_case(tmp_path / "log.csv")
