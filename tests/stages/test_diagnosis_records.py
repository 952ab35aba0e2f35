"""From files to verdict: a recording written here, and real records where they are at hand."""

import json
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.io.recordings.measured import load_reading
from simgap.plants.plant_model import PlantModel
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "../shared/data"
needs_records = pytest.mark.skipif(not RECORDS.is_dir(), reason="the real records are not beside the project")


def write_csv(path, data):
    (trace,) = data.traces
    table = np.column_stack([trace.t, trace.y, trace.u])
    np.savetxt(path, table, delimiter=",", header="t," + ",".join((*data.measured, *data.inputs)), comments="")
    return path


def test_friction_is_found_in_a_file(tmp_path):
    case = tmp_path / "case.yaml"
    case.write_text(
        example.CASE + "measured: {effects: [coulomb_friction, viscous_friction, spring], max_effects: 2}\n"
    )
    said = []
    result = stage.run(case, [write_csv(tmp_path / "bench.csv", example.record())], tmp_path / "out", said.append)
    assert result["verdict"] == "attributed"
    (effect,) = result["effects"]
    assert (effect["name"], effect["on"]) == ("coulomb_friction", "hinge")
    assert effect["parameters"]["F_c"]["value"] == pytest.approx(example.FRICTION, abs=0.003)
    assert result["error"]["after"]["horizon_rmse"]["q"] < 0.3 * result["error"]["before"]["horizon_rmse"]["q"]
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] == "attributed"
    assert {p.name for p in (tmp_path / "out").iterdir()} >= {
        "diagnosis.json",
        "report.html",
        "corrected_case.yaml",
        "residual.rrd",
    }
    assert said[0] == "reading 1 file"
    again = stage.run(tmp_path / "out" / "corrected_case.yaml", [], tmp_path / "again")
    assert again["verdict"] == "none"  # the corrected case, on the same data, lacks nothing


def test_a_mistake_leaves_nothing_behind(tmp_path):
    case = tmp_path / "case.yaml"
    case.write_text(example.CASE)
    bad = write_csv(tmp_path / "bench.csv", example.record(seconds=2.0))
    bad.write_text(bad.read_text().replace("\n", "\nnan,", 3))
    with pytest.raises(UserError) as error:
        stage.run(case, [bad], tmp_path / "out")
    assert str(bad) in str(error.value)
    assert not (tmp_path / "out").exists()


@needs_records
@pytest.mark.parametrize(
    ("name", "traces", "held_out"),
    [
        ("dfki_pendulum", {"energy_shaping": 790, "ddp": 3000}, ("ddp",)),
        ("multiarm_pendulum", {f"free_swing_{k}": 9167 for k in range(1, 5)}, ("free_swing_2", "free_swing_4")),
    ],
)
def test_the_real_records_are_read_as_their_cases_say(name, traces, held_out):
    path = ROOT / "configs" / "cases" / f"{name}.yaml"
    case = load_case(path)
    model = PlantModel.of(case, path.parent).corrected
    reading = load_reading(model, case.measured, [path.parent / f for f in case.measured.files], path.parent)
    assert {t.name: len(t.t) for t in reading.record.traces} == traces
    assert reading.held_out == held_out
    assert reading.record.measured == ("q", "v")
    for trace in reading.record.traces:
        assert abs(np.mean(trace.y[:, 0])) < 1.6  # angles count from hanging, not from pi


@needs_records
def test_damping_of_the_free_pendulum_transfers_to_other_segments(tmp_path):
    source = ROOT / "configs" / "cases" / "multiarm_pendulum.yaml"
    text = source.read_text().replace("../../../shared", str(RECORDS.resolve().parent))
    (tmp_path / "case.yaml").write_text(f"{text}  effects: [viscous_friction]\n")
    result = stage.run(tmp_path / "case.yaml", [], tmp_path / "out")
    assert [e["name"] for e in result["effects"]] == ["viscous_friction"]
    before, after = (result["error"][w]["horizon_rmse"]["q"] for w in ("before", "after"))
    assert after <= 0.4 * before
    assert result["error"]["before"]["horizon_s"] == 3.0
