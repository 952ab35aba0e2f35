"""What the stage writes, from a diagnosis made by hand: contract keys, page, pictures, recording, corrected case."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.measured import MeasuredSection
from simgap.correction.corrected_case import corrected_case
from simgap.diagnosis.record.survey import survey
from simgap.diagnosis.result import Estimate, FoundEffect, LeftOver, Nearest
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

ARM = """\
name: arm
plant:
  urdf: models/arm.urdf
  states:
    q: {unit: rad, joint: j, quantity: position}
    v: {unit: rad/s, joint: j, quantity: velocity}
  inputs:
    u: {unit: N*m, joint: j}
simulator: {engine: pybullet, inertia: file}
measured: {files: [a.csv]}
"""


def write(folder, verdict="attributed", more="", **changes):
    (folder / "case.yaml").write_text(example.CASE + more)
    context = Context.load(folder / "case.yaml")
    model = PlantModel(context.case.plant, folder).corrected
    data = example.record()
    found, reading, section = (
        replace(example.diagnosis(model, data, verdict), **changes),
        example.reading(data),
        context.case.measured or MeasuredSection(),
    )
    return stage.conclude(context, section, found, reading, survey(data, model), [folder / "bench.csv"], folder / "out")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("diagnosis")
    write(folder)
    return folder / "out"


def test_the_document_has_the_keys_of_the_contract(written):
    d = json.loads((written / "diagnosis.json").read_text())
    assert d["verdict"] == "attributed"
    (effect,) = d["effects"]
    assert effect["parameters"] == {"F_c": {"value": 0.19, "ci95": [0.18, 0.2], "unit": "N*m"}}
    assert effect["alternatives"] == [[{"name": "stribeck_friction", "on": "hinge"}]]
    for which in ("before", "after", "noise_floor"):
        assert set(d["error"][which]) == {"fit_rmse", "horizon_s", "horizon_rmse"}
        assert set(d["error"][which]["horizon_rmse"]) == {"q", "v"}
    assert d["held_out"] == {
        "traces": [],
        "windows": [{"trace": "bench", "from": 2.0, "to": 3.0}, {"trace": "bench", "from": 6.0, "to": 7.0}],
    }
    assert {fold: [w["from"] for w in d["folds"][fold]["windows"]] for fold in d["folds"]} == {
        "fit": [0.0, 3.0, 7.0],
        "choose": [5.0, 9.0],
        "confirm": [2.0, 6.0],
    }
    assert d["number_from"]["error"] == d["number_from"]["remainder"] == ["confirm"]
    assert d["number_from"]["effects"] == ["fit", "choose"]
    assert {"file", "sha256", "rows"} <= set(d["data"][0])
    assert {"name", "on", "score"} <= set(d["candidates"][0])
    assert isinstance(d["warnings"], list)
    assert "explains 84 % of the excess error" in d["sentence"]
    assert set(d["remainder"]["after"]) == {"q", "v"}
    assert {"stage", "reads", "code", "versions"} <= set(d["provenance"])
    assert str(written.parent) not in json.dumps(d)


def test_the_page_tells_what_comes_nearest_and_what_else_would_help(tmp_path):
    drag = FoundEffect("viscous_friction", "hinge", {"b": Estimate(0.0714, (0.07, 0.073), "N*m*s/rad")})
    bias = FoundEffect("input_bias", "u", {"bias": Estimate(0.031, (0.03, 0.032), "N*m")})
    near = Nearest((drag,), 0.43, ("halves of the data give different numbers",))
    write(tmp_path, "unexplained", nearest=near, left_over=(LeftOver(bias, 0.27),))
    page = (tmp_path / "out" / "report.html").read_text()
    nearest = page[page.index("<h2>Nearest explanation") : page.index("<h2>Other effects")]
    over = page[page.index("<h2>Other effects") : page.index("<h2>Error before and after")]
    for told in ("Viscous friction", "0.0714", "43 %", "halves of the data give different numbers"):
        assert told in nearest
    for told in ("Input bias", "0.031", "27 %", "None is established"):
        assert told in over
    assert "Input bias" not in nearest


def test_the_page_says_that_a_remainder_is_not_in_gamma(tmp_path):
    """Nothing that could bound it was held out, or the case has no gap: the page is not silent about it."""
    write(tmp_path, "partial")
    assert "Not in gamma: the case has no" in (tmp_path / "out" / "report.html").read_text()
    write(tmp_path, "partial", windows=tuple(replace(w, held_out=False) for w in example.windows(example.record())))
    assert "Not in gamma: too few" in (tmp_path / "out" / "report.html").read_text()


def test_the_page_stands_alone(written):
    page = example.without_scripts(written / "report.html")
    assert "Coulomb friction of 0.19 ± 0.01 N m at the hinge explains 84 %" in page
    assert page.count("<svg") >= 4
    outside = re.findall(r'(?:src|href)="(?!#)([^"]+)"', page)
    assert [link for link in outside if not link.startswith("http://www.w3.org")] == []
    assert "from the held-out data <em>confirm</em> alone: 2 to 3 and 6 to 7 s of bench" in page
    for heading in (
        "Error before and after",
        "Measured against predicted",
        "Residual against",
        "Step by step",
        "The recordings",
    ):
        assert heading in page
    assert "&lt;svg" not in page


def test_pictures_are_there_and_not_empty(written):
    from xml.etree import ElementTree

    for name in ("error", "measured-1", "residual-1", "steps"):
        picture = ElementTree.parse(written / f"{name}.svg")
        coloured = {p.get("style") for p in picture.iter("{http://www.w3.org/2000/svg}path")}
        assert len(coloured) > 5


def test_the_same_content_gives_the_same_bytes(written, tmp_path):
    write(tmp_path)
    for path in written.iterdir():
        if path.suffix != ".rrd":
            assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes(), path.name
    assert not [p for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize("verdict", ["none", "partial", "unexplained"])
def test_every_verdict_has_a_page(tmp_path, verdict):
    content = write(tmp_path, verdict)
    page = (tmp_path / "out" / "report.html").read_text()
    assert content["sentence"] == " ".join(content["sentences"])
    assert all(part in page for part in content["sentences"])
    assert bool(content["effects"]) == (verdict == "partial")
    case = load_case(tmp_path / "out" / "corrected_case.yaml")
    assert len(case.plant.effects) == (1 if verdict == "partial" else 0)
    assert case.name == ("bench_corrected" if verdict == "partial" else "bench")


GAP = "domain: {tau: 0.05 s, X: {q: [-1, 1], v: [-3, 3]}, U: {u: {min: -2, max: 2, step: 1}}}\ngap: {basis: [1]}\n"
ON_HARDWARE, IN_SIMULATOR = "measured: {rig: hardware}\n", "measured: {rig: simulator}\n"


@pytest.mark.parametrize(
    ("more", "bounded", "reason"),
    [
        (GAP + ON_HARDWARE, True, "its one-step part is bounded into gamma"),
        (ON_HARDWARE, False, "for which no explanation in the library was found."),
        (GAP + IN_SIMULATOR, False, "it is not bounded into gamma: the recordings are of the case's own"),
        (
            GAP + ON_HARDWARE + "hidden_state: {previous: {u: 3}}\n",
            False,
            "it is not bounded into gamma: the bound of a simulator with",
        ),
    ],
)
def test_a_partial_verdict_says_what_was_done_with_the_remainder(tmp_path, more, bounded, reason):
    content = write(tmp_path, "partial", more)
    case = load_case(tmp_path / "out" / "corrected_case.yaml")
    given = dict(case.gap.remainder) if case.gap is not None else {}
    assert given == (content["remainder"]["after"] if bounded else {})
    assert content["remainder"]["bounded"] is bounded
    assert reason in content["sentence"]
    assert content["remainder"]["reason"] in (tmp_path / "out" / "report.html").read_text().replace("&#39;", "'")


def test_the_recording_reads_back(written):
    from rerun.chunk import RrdReader

    data, columns = example.record(), {}
    for chunk in RrdReader(written / "residual.rrd").store().stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith("Scalars:scalars") and "sim_time" in batch.schema.names:
                times = batch.column("sim_time").cast("int64").to_numpy() * 1e-9
                values = np.array([v[0] for v in batch.column(name).to_pylist()])
                columns.setdefault(str(chunk.entity_path), []).append((times, values))
    found = {path: tuple(np.concatenate(side) for side in zip(*parts, strict=True)) for path, parts in columns.items()}
    residuals = {f"/bench/residual/{s}/{side}" for s in "qv" for side in ("before", "after")}
    states = {f"/bench/{s}/{side}" for s in "qv" for side in ("measured", "before", "after")}
    assert set(found) == residuals | states | {"/bench/input/u", "/bench/never_fitted"}
    when, held = found["/bench/never_fitted"]
    wanted = np.concatenate([np.full(len(w.t), float(w.held_out)) for w in example.windows(data)])
    assert set(wanted) == {0.0, 1.0}
    assert np.array_equal(held[np.argsort(when)], wanted)
    times, values = found["/bench/q/measured"]
    order = np.argsort(times)
    np.testing.assert_allclose(times[order], data.traces[0].t, atol=2e-9)
    np.testing.assert_allclose(values[order], data.traces[0].y[:, 0])
    np.testing.assert_allclose(found["/bench/residual/q/after"][1], values - found["/bench/q/after"][1], atol=1e-12)


def test_the_corrected_case_runs_from_where_it_is(tmp_path):
    case, target = tmp_path / "case.yaml", tmp_path / "results" / "deep" / "corrected_case.yaml"
    case.write_text(ARM)
    source = Path(__file__).parents[2] / "configs" / "models" / "pendulum.urdf"
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "arm.urdf").write_text(source.read_text())
    joint = re.search(r'<joint name="([^"]+)" type="(?:revolute|continuous)"', source.read_text()).group(1)
    case.write_text(case.read_text().replace("joint: j", f"joint: {joint}"))
    target.parent.mkdir(parents=True)
    found = [AppliedEffect("viscous_friction", joint, {"b": np.float64(0.05)})]
    for rig, twins in (("hardware", 1), ("simulator", 0)):
        target.write_text(corrected_case(case, target, found, [tmp_path / "a.csv"], rig, "Found."))
        again = load_case(target)
        assert (target.parent / again.plant.urdf).resolve() == (tmp_path / "models" / "arm.urdf").resolve()
        assert again.measured.files == ("../../a.csv",)
        assert [dict(e.parameters) for e in again.plant.effects] == [{"b": 0.05}]
        assert len(again.simulator.effects) == twins
        assert PlantModel.of(again, target.parent).corrected.parameters[f"{joint}.viscous_friction.b"].value == 0.05
    second = tmp_path / "results" / "second.yaml"
    text = corrected_case(target, second, [AppliedEffect("spring", joint, {"k": 0.1})], [], "hardware", "Again.")
    assert text.count("name: arm_corrected\n") == 1
    assert [line for line in text.splitlines() if line.startswith("#")]
    assert "simulator both have the effects" in text
    offset = [AppliedEffect("sensor_offset", next(iter(again.plant.states)), {"offset": 0.01})]
    assert "simulator both" not in corrected_case(case, second, offset, [], "hardware", "Found.")  # of a reading alone


OWN_ENGINE = """
from simgap.config.simulator import EngineSection

class Mine(EngineSection):
    pass
"""


def test_the_corrected_case_finds_the_engine_that_stands_beside_its_case(tmp_path):
    (tmp_path / "mine.py").write_text(OWN_ENGINE)
    write(tmp_path, more=GAP + "simulator: {engine: 'mine.py:Mine'}\n")
    case = load_case(tmp_path / "out" / "corrected_case.yaml")
    file, _, name = case.simulator.engine.partition(":")
    assert name == "Mine"
    assert (tmp_path / "out" / file).read_text() == OWN_ENGINE
    (tmp_path / "mine.py").write_text(OWN_ENGINE + "# another one\n")
    write(tmp_path, more=GAP + "simulator: {engine: 'mine.py:Mine'}\n")
    again = load_case(tmp_path / "out" / "corrected_case.yaml").simulator.engine
    assert again.partition(":")[0] not in ("mine.py", file)


def test_a_case_without_data_says_what_to_do(tmp_path):
    (tmp_path / "case.yaml").write_text(example.CASE)
    with pytest.raises(UserError, match=r"measured\.files: no data are given"):
        stage.run(tmp_path / "case.yaml", [], tmp_path / "out")
    assert not (tmp_path / "out").exists()
