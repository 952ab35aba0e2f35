"""YAML of strangers: every key once, no bombs, nothing that turns into a date; each mistake is one short line."""

import pytest

from simgap.cli import main
from simgap.config.load import DEEPEST, LARGEST, load_case, read_yaml
from simgap.config.run import load_rig
from simgap.errors import UserError


def content(tmp_path, text):
    path = tmp_path / "case.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_yaml(path)


def test_scalars_are_what_they_look_like(tmp_path):
    text = "a: 010\nb: 1e-3\nc: .5\nd: 1:30\ne: 2024-13-45\nf: yes\ng: true\nh: ~\ni: 0x10\non: -.5e2\ny: '3'\nk: 7."
    assert content(tmp_path, text) == {
        "a": 10, "b": 0.001, "c": 0.5, "d": "1:30", "e": "2024-13-45", "f": "yes", "g": True, "h": None, "i": "0x10",
        "on": -50.0, "y": "3", "k": 7.0}  # fmt: skip


def test_aliases_and_merges_still_work(tmp_path):
    assert content(tmp_path, "a: &b {c: 1, d: 2}\ne: {<<: *b, c: 3}\nf: *b") == {
        "a": {"c": 1, "d": 2}, "e": {"c": 3, "d": 2}, "f": {"c": 1, "d": 2}}  # fmt: skip


def test_commas_within_quotes_and_blocks_are_text(tmp_path):
    text = "a: f(x, y)\nb: ['f(x, y)', \"d,e.csv\", (x), g(x]\nc: {d: , e: f(x), 'g': 1}"
    assert content(tmp_path, text) == {
        "a": "f(x, y)", "b": ["f(x, y)", "d,e.csv", "(x)", "g(x"], "c": {"d": None, "e": "f(x)", "g": 1}}  # fmt: skip


BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(20)
)
REFUSED = {
    "twice": ("a: 1\nb: 2\na: 3", r"line 3: .*'a' appears twice, first in line 1"),
    "twice within": ("a:\n  b: {c: 1,\n   c: 2}", r"line 3: .*'c' appears twice, first in line 2"),
    "twice, quoted": ('a: 1\n"a": 2', "twice"),
    "number as key": ("a: {1: 2}", "'1' is not a name"),
    "bool as key": ("true: 2", "'true' is not a name"),
    "list as key": ("[a]: 2", "a list or mapping is not a name"),
    "bomb": (BOMB, "values, aliases included"),
    "itself": ("a: &x [*x]", "within itself"),
    "no anchor": ("a: *x", "undefined alias"),
    "deep": ("[" * 200_000, f"more than {DEEPEST} levels"),
    "deep and closed": ("a: " + "[" * 2000 + "]" * 2000, f"more than {DEEPEST} levels"),
    "deep blocks": ("".join(" " * k + "a:\n" for k in range(1200)), f"more than {DEEPEST} levels"),
    "digits": ("a: " + "9" * 5001, "not valid YAML"),
    "date by force": ("a: !!timestamp 2024-13-45", "month"),
    "code": ("a: !!python/object/apply:os.system [ls]", "constructor"),
    "bool by force": ("a: !!bool x", "not valid YAML"),
    "set by force": ("a: !!omap [1]", "not valid YAML"),
    "binary": (bytes(range(128, 256)), "not UTF-8"),
    "control": (b"a: \x00", "not valid YAML"),
    "large": ("#" * (LARGEST + 1), "the most are"),
    "echo": ("a: {" + "x" * 20_000 + " 'b", "not valid YAML"),
    "tab": ("a:\n\tb: 1", "line 2: not valid YAML: a tab in the indentation. Indent with spaces"),
    "comma in a list": ("a: 1\nb: [f(x, g(y, z)), 2]", r"line 2: .*'f\(x' is cut at a comma.*in quotes"),
    "comma in a mapping": ("b: {c: f(x, y), d: 2}", r"line 1: .*'f\(x' is cut at a comma.*in quotes"),
    "comma in a name": ("b: {c: d,e.csv, f: 2}", r"line 1: .*'e.csv' has no value.*in quotes"),
    "two documents": ("--- a\n--- b", "another document"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_one_short_line(tmp_path, name):
    text, match = REFUSED[name]
    with pytest.raises(UserError, match=match) as caught:
        content(tmp_path, text)
    told = str(caught.value).replace(str(tmp_path), "")
    assert "\n" not in told
    assert told.startswith("/case.yaml")
    assert len(told) < 300


def test_folders_are_no_files(tmp_path):
    with pytest.raises(UserError, match="is a folder"):
        read_yaml(tmp_path)


def test_a_key_twice_in_a_case_or_a_rig_ends_the_command_with_status_2(root, tmp_path, capsys):
    case = tmp_path / "case.yaml"
    case.write_text((root / "configs/cases/pendulum.yaml").read_text() + "\nname: other\n")
    with pytest.raises(SystemExit) as left:
        main(["grid", str(case), "--out", str(tmp_path / "x"), "--log", str(tmp_path / "log")])
    assert left.value.code == 2
    told = capsys.readouterr().err
    assert "'name' appears twice" in told
    assert told.count("\n") == 1
    rig = tmp_path / "rig.yaml"
    rig.write_text((root / "configs/rigs/pendulum.yaml").read_text() + "\nseed: 1\nseed: 2\n")
    with pytest.raises(UserError, match="'seed' appears twice"):
        load_rig(rig)


@pytest.mark.parametrize("name", ["2024-01-05", "[a, b]", "{a: b}", "3", "x" * 20_000, "~", "'\\e[31m'", '"\\e[31m"'])
def test_a_name_that_is_none_is_one_short_line(root, tmp_path, name):
    text = (root / "configs/cases/pendulum.yaml").read_text()
    path = tmp_path / "case.yaml"
    path.write_text("\n".join(f"name: {name}" if line.startswith("name:") else line for line in text.splitlines()))
    with pytest.raises(UserError) as caught:
        load_case(path)
    told = str(caught.value).replace(str(tmp_path), "")
    assert told.startswith("/case.yaml: name")
    assert told.isprintable()
    assert len(told) < 400


@pytest.mark.parametrize("value", [".inf", ".nan", "-.inf"])
def test_numbers_of_a_case_are_finite(root, tmp_path, value):
    text = (root / "configs/cases/pendulum.yaml").read_text()
    path = tmp_path / "case.yaml"
    path.write_text(text.replace("max: 1.2", f"max: {value}"))
    assert path.read_text() != text
    with pytest.raises(UserError, match="finite"):
        load_case(path)


def test_a_rate_may_be_a_plain_number(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text(
        "name: slide\nplant:\n  symbolic: {dynamics: {x: 1e-3, y: 0}}\n  states: {x: {unit: m}, y: {unit: m}}\n"
    )
    assert load_case(path).plant.symbolic.dynamics == {"x": "0.001", "y": "0"}
