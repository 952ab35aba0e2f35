"""Names out of somebody's files are text in pictures, pages and corrected cases; no picture takes an answer along."""

import json
from dataclasses import replace

import pytest

from simgap.config.load import load_case
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.record.survey import survey
from simgap.io import figure_style as style
from simgap.plants.context import Context
from simgap.report import diagnosis_page
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

NAME = "r1_$x_{$ <b>\x1b[31m\udc80\u202e"
TOLD = r"r1_$x_{$ &lt;b&gt;\x1b[31m\udc80\u202e"


def write(folder, name):
    (folder / "case.yaml").write_text(example.CASE)
    context = Context.load(folder / "case.yaml")
    data = example.record(seconds=8.0)
    record = Record((replace(data.traces[0], name=name),), data.measured, data.inputs)
    found = example.diagnosis(context.plant.corrected, data)
    folds = {fold: tuple((name, *ends) for _, *ends in f) for fold, f in found.folds.items()}
    found = replace(found, windows=tuple(replace(w, trace=name) for w in found.windows), folds=folds)
    look, section = survey(record, context.plant.corrected), context.case.measured or stage.MeasuredSection()
    return stage.conclude(context, section, found, example.reading(record), look, [folder / "b.csv"], folder / "out")


def test_a_trace_with_signs_of_formulas_and_of_terminals(tmp_path):
    write(tmp_path, NAME)
    page = example.without_scripts(tmp_path / "out/report.html")
    assert f"{TOLD}: measured, predicted by the" in page
    assert page.count("<svg") == 4
    assert not set(page) & set("\x1b\u202e")
    assert json.loads((tmp_path / "out/diagnosis.json").read_text())["survey"]["traces"][0]["name"] == NAME
    assert load_case(tmp_path / "out/corrected_case.yaml").name == "bench_corrected"
    assert (tmp_path / "out/residual.rrd").stat().st_size > 1000


def test_a_picture_that_fails_is_told_where_it_should_stand(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(diagnosis_page, "overlay_figure", lambda *_: 1 / 0)
    write(tmp_path, "bench")
    page = example.without_scripts(tmp_path / "out/report.html")
    assert "measured-1.svg could not be drawn" in page
    assert page.count("<svg") == 3
    assert "measured-1.svg could not be drawn: ZeroDivisionError" in caplog.text
    assert not (tmp_path / "out/measured-1.svg").exists()


def test_the_answer_is_written_before_anything_is_drawn(tmp_path, monkeypatch):
    def drawn(*_):
        assert {p.name for p in (tmp_path / "out").iterdir()} == {
            "diagnosis.json", "corrected_case.yaml", "transitions.parquet"
        }  # fmt: skip
        raise RuntimeError("drawn")

    monkeypatch.setattr(stage, "draw", drawn)
    with pytest.raises(RuntimeError, match="drawn"):
        write(tmp_path, "bench")
    assert json.loads((tmp_path / "out/diagnosis.json").read_text())["verdict"] == "attributed"


def test_powers_of_ten_are_drawn_and_names_on_an_axis_are_text():
    with style.figure_style():
        figure, ((left, right),) = style.panels(1, 2, 4.8)
        left.loglog([1e-5, 20.0], [0.2, 0.9])  # less than a decade: matplotlib writes factors beside powers
        right.set_yticks([0, 1], ["$a_{$", "b\x1b"])
        right.set_title("$y_{$\x1b")
        text = style.svg_text(figure)
        labels = [[t.get_text() for t in a.get_ticklabels() + a.get_ticklabels(minor=True)] for a in
                  (left.xaxis, left.yaxis, right.yaxis)]  # fmt: skip
    assert {"10⁻⁵", "10⁻³", "10⁻¹", "10¹"} <= set(labels[0])
    assert {"2×10⁻¹", "6×10⁻¹"} <= set(labels[1])
    assert labels[2] == ["$a_{$", r"b\x1b"]
    assert r"<!-- $y_{$\x1b -->" in text
    assert "math" not in text
