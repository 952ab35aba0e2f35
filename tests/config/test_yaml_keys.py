"""A case is YAML with the booleans of version 1.2: `on` is a key like any other."""

from simgap.config.load import read_yaml


def test_on_and_y_are_words(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text("effects: [{name: spring, on: hinge}]\ny: no\nok: true\noff: False\n")
    assert read_yaml(path) == {"effects": [{"name": "spring", "on": "hinge"}], "y": "no", "ok": True, "off": False}
