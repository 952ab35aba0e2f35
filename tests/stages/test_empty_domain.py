"""The stage `synthesis` where nothing wins: the summary, a file beside it and the last line of the log say why."""

import pytest

from simgap.cli import main
from simgap.io.results import read_json


def test_it_is_told_in_the_summary_and_on_the_terminal(vary, tmp_path, capfd):
    safe = {"kind": "invariance", "safe": {"x1": [0.15, 0.2], "x2": [-0.5, 0.5]}}
    path = vary("pendulum", {"synthesis": {"cells": [40, 40], "specification": safe}, "domain.U.u": {"values": [0.0]}})
    out, summary = tmp_path / "controller.npz", tmp_path / "synthesis.json"
    with pytest.raises(SystemExit) as ended:
        main(["synthesis", str(path), "--out", str(out), "--summary", str(summary), "--workers", "1"])
    assert ended.value.code == 2
    assert not out.exists()
    found = read_json(summary)
    assert found["winning_cells"] == 0
    assert found["empty"]["cause"] == "specification"
    assert [a["state"] for a in found["empty"]["axes"]] == ["x1", "x2"]
    assert read_json(tmp_path / "empty.json")["empty"] == found["empty"]
    last = capfd.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("simgap: ")
    assert found["empty"]["sentence"] in last
