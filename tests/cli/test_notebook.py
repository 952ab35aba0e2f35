"""The notebook of the Python API runs from its first cell to its last, where a person would start it."""

import json
import shutil

import pytest


@pytest.fixture(scope="module")
def cells(root):
    return json.loads((root / "docs/tutorials/notebook.ipynb").read_text())["cells"]


def test_every_cell_runs(cells, root, tmp_path, monkeypatch, capsys):
    for name in ("rod.yaml", "rod.urdf", "machine.urdf", "swings.csv"):
        shutil.copy(root / "docs/tutorial" / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
    assert names["found"]["verdict"] == "attributed"
    assert [e["name"] for e in names["found"]["effects"]] == ["parameter_error", "viscous_friction"]
    assert (tmp_path / "rod_with_friction.urdf").is_file()
    angle, _ = names["context"].get_continuous_state_vector().CopyToVector()
    assert angle != 0.2
    assert "2 states in Drake" in capsys.readouterr().out


def test_it_is_kept_without_what_it_printed(cells):
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) >= 7
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
