"""The page of a case says what the results say, opens offline, and is the same bytes every time."""

import base64
import re
from html.parser import HTMLParser

import numpy as np
import pyarrow as pa
import pytest

from simgap.errors import UserError
from simgap.io.pages import NO_CONTROLLER
from simgap.io.results import read_json, table, write_json, write_parquet
from simgap.notation import number
from simgap.stages import index, report
from simgap.stages.report import ReportFiles
from tests.stages import loop_example as example


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory, root):
    folder = tmp_path_factory.mktemp("pendulum")
    case = example.pendulum(root, folder)
    (folder / NO_CONTROLLER).write_text("of an earlier run")
    report.run(case, ReportFiles(**example.arguments(folder)), folder / "report.html", folder / "summary.json")
    return folder, case


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    case = example.robot(folder)
    report.run(case, ReportFiles(**example.arguments(folder)), folder / "report.html", folder / "summary.json")
    return folder


class Page(HTMLParser):
    """Text and every address that a page refers to."""

    VOID = ("meta", "br", "img", "link", "hr", "input")

    def __init__(self, text):
        super().__init__()
        self.addresses, self.words, self.open, self.figures = [], [], [], 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.figures += tag == "figure"
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href") and v]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", "".join(self.words))


def page(folder):
    return Page((folder / "report.html").read_text())


def test_the_page_takes_the_place_of_the_one_without_a_controller(pendulum):
    assert not (pendulum[0] / NO_CONTROLLER).exists()


def test_failures_that_are_counted_when_the_time_is_up_have_no_instant(pendulum, root, tmp_path):
    """Half of the runs that never arrived failed "within" the length of a run: that says nothing."""
    case = example.pendulum(root, tmp_path)
    given = example.arguments(tmp_path)
    validation = read_json(given["validation"])
    validation["controllers"]["nominal"]["simulator"]["median_steps_until_violation"] = validation["steps"]
    write_json(given["validation"], validation)
    report.run(case, ReportFiles(**given), tmp_path / "report.html", tmp_path / "summary.json")
    text = page(tmp_path).text
    assert "in 2 of 2 runs, most of them counted at the end of the run." in text
    assert "half of the failures" not in text


def test_the_verdict_is_the_counts(pendulum):
    text = page(pendulum[0]).text
    assert "In 2 simulated runs of 0.2 s, checked every 0.005 s, the controller that knows the gap never left" in text
    assert re.search(
        r"The controller that trusts the model left the safe set in 2 of 2 runs, half of the failures within [\d.]+ s",
        text,
    )
    assert "Gap-aware controller: 2 of 2 runs safe, 0 of 80 steps outside gamma." in text
    assert "Nominal-only controller: 2 of 2 runs violate the specification in the simulator" in text
    assert "promise kept" in text
    assert "2 of 2 runs left the safe set" in text  # a tile counts as the sentence does


def test_the_page_needs_nothing_else(pendulum, robot):
    for folder in (pendulum[0], robot):
        shown = page(folder)
        outside = [a for a in shown.addresses if not a.startswith(("data:", "#"))]
        assert outside == []
        text = (folder / "report.html").read_text()
        assert not re.search(r"url\(['\"]?https?:|@import|<script[^>]* src=", text)
        assert not shown.open


def test_the_pendulum_has_its_pictures(pendulum):
    assert page(pendulum[0]).figures == 5  # the question, trajectories, winning domains, bound, gap along the run


def test_the_robot_has_its_pictures(robot):
    shown = page(robot)
    assert shown.figures == 6  # the question, arena, times, slices, bound over the inputs, gap along the run
    assert "in the target without touching anything" in shown.text


def test_a_bound_without_a_point_of_eps_has_a_page(robot):
    """A robot's bound over histories has neither eps nor half-widths; its page is the last step of a long run."""
    assert "eps" not in example.read_json(robot / "gap.json")
    assert re.search(r"Fitted on [\d,]+ roll-outs\.", page(robot).text)


def test_no_machine_paths_and_no_dates(pendulum):
    folder, _ = pendulum
    for name in ("report.html", "summary.json"):
        text = (folder / name).read_text()
        assert str(folder) not in text
        assert not re.search(r"20[2-9]\d-\d\d-\d\dT", text)


def test_the_same_bytes_again(pendulum, tmp_path):
    folder, case = pendulum
    report.run(case, ReportFiles(**example.arguments(folder)), tmp_path / "report.html", tmp_path / "summary.json")
    for name in ("report.html", "summary.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_the_summary_holds_the_numbers(pendulum):
    folder, _ = pendulum
    summary, gap = example.read_json(folder / "summary.json"), example.read_json(folder / "gap.json")
    synthesis = example.read_json(folder / "gap/synthesis.json")
    assert summary["promise_kept"] is True
    assert summary["winning_fraction"]["gap"] == synthesis["winning_fraction"]
    for row in gap["dimensions"]:
        assert summary["sup_gamma"][0]["states"][row["state"]]["size"] == row["sup_size"]
    assert summary["closed_loop"]["nominal"]["simulator"]["runs_that_violated_it"] == 2


def test_printed_values_stand_beside_ours(pendulum, tmp_path, root):
    """A gap.json at an eps of the paper's table gets the paper's number in its row."""
    folder, case = pendulum
    content = example.read_json(folder / "gap.json") | {"eps": 0.0056}
    write_json(tmp_path / "gap.json", content)
    printed = root / "configs/paper/printed.yaml"
    given = example.arguments(folder) | {"gaps": [folder / "gap.json", tmp_path / "gap.json"], "printed": printed}
    report.run(case, ReportFiles(**given), tmp_path / "report.html", tmp_path / "summary.json")
    text = page(tmp_path).text
    assert "printed in the paper" in text
    assert "0.00757" in text
    assert page(tmp_path).figures == 6


def test_a_broken_promise_is_the_headline(pendulum, tmp_path):
    folder, case = pendulum
    content = example.read_json(folder / "validation/validation.json")
    content["controllers"]["gap"]["simulator"]["steps_outside_gamma"] = 3
    write_json(tmp_path / "validation.json", content)
    synthesis = example.read_json(folder / "gap/synthesis.json") | {"between_samples": {"x1": 0.0025, "x2": 0.0}}
    write_json(tmp_path / "synthesis.json", synthesis)
    given = example.arguments(folder) | {"validation": tmp_path / "validation.json"}
    given["gap_aware_summary"] = tmp_path / "synthesis.json"
    report.run(case, ReportFiles(**given), tmp_path / "report.html", tmp_path / "summary.json")
    text = page(tmp_path).text
    assert "promise broken" in text
    assert "3 of 80 steps outside gamma" in text
    assert "at most 0.0025 rad in x1, so it" in text


def corrected(case, bound, summary, arguments):
    """The files of a corrected case whose controllers are those of the first."""
    controllers = {f"corrected_{kind}": arguments[kind] for kind in ("nominal", "gap_aware")}
    return {"corrected": case, "corrected_gap": bound, "corrected_summary": summary, **controllers}


def test_the_corrected_case_stands_beside_the_first(pendulum, tmp_path):
    folder, case = pendulum
    after = example.read_json(folder / "summary.json")
    after["winning_fraction"]["gap"] = 0.8125
    write_json(tmp_path / "summary.json", after)
    arguments = example.arguments(folder)
    given = ReportFiles(**arguments, **corrected(case, folder / "gap.json", tmp_path / "summary.json", arguments))
    report.run(case, given, tmp_path / "report.html", tmp_path / "after.json")
    shown = page(tmp_path)
    assert re.search(r"winning fraction, gap-aware\s*[\d.]+\s*81.25\s*%", shown.text)
    assert "corrected/report.html" in shown.addresses


def test_measured_transitions_are_held_against_the_bound_that_was_given(pendulum, tmp_path):
    """A bound beside it, in a folder that sorts later, is not what the page tells of."""
    folder, case = pendulum
    start = np.zeros((50, 2))
    columns = {"x1": start[:, 0], "x2": start[:, 1], "u": np.zeros(50), "late_u": np.zeros(50)}
    columns |= {"next_x1": np.full(50, 0.02), "next_x2": np.full(50, 0.02)}  # the model stays at rest
    write_parquet(tmp_path / "transitions.parquet", pa.table(columns))
    document = {"noise": {"x1": 1e-4, "x2": 1e-4}, "provenance": example.record(folder, "diagnosis")}
    write_json(tmp_path / "diagnosis.json", document)
    arguments = example.arguments(folder)
    shares = {}
    for name, by in (("eps~0.0022", 1.0), ("eps~0.0056", 0.0)):
        content = example.read_json(folder / "gap.json")
        for sides in content["gap"].values():
            sides["upper"]["offset"] += by
        (tmp_path / name).mkdir()
        write_json(tmp_path / name / "gap.json", content)
    for name in ("eps~0.0022", "eps~0.0056"):
        later = corrected(case, tmp_path / name / "gap.json", folder / "summary.json", arguments)
        found = {"diagnosis": tmp_path / "diagnosis.json", "transitions": tmp_path / "transitions.parquet"}
        shares[name] = report.read(case, ReportFiles(**arguments, **found, **later)).corrected.inside["after"]
    assert shares["eps~0.0022"]["share"] == 1.0
    assert shares["eps~0.0056"]["share"] == 0.0


def test_the_adversary_stands_beside_the_random_samples(pendulum, tmp_path):
    folder, case = pendulum
    cells = 20 * 10
    loop = {"runs": 7, "steps": 1234, "violations": 0, "steps_outside_gamma": 0, "ends": {"stayed": 7},
            "steps_by_rule": {"nearest to losing": 1234}}  # fmt: skip
    quantiles = {"least": 1.5, "five_percent": 2.25, "median": 31.0}
    audit = {
        "evaluations": 5678, "steps": 1234, "violations": 0, "witnesses": [],
        "gap": {"violations": 0, "evaluations_by_search": {"climbing": 5678}, "largest_share": -0.25,
                "worst": {"x1": -0.2, "x2": 0.5}},
        "closed_loop": {"simulator": loop, "disturbance": loop | {"steps": 4321}},
        "margins": {"cells": 150, "lose_by": {"gamma": 7, "cells": 1}, "factor": quantiles, "largest_looked_for": 1e6},
        "provenance": example.record(folder, "audit"),
    }  # fmt: skip
    rng = np.random.default_rng(0)
    columns = {"factor": np.where(rng.random(cells) < 0.2, np.nan, 1 + rng.random(cells)).astype(np.float32)}
    columns["loses_by"] = np.where(np.isnan(columns["factor"]), 1, 0).astype(np.uint8)
    write_parquet(tmp_path / "margins.parquet", table(columns, {}, {}, example.record(folder, "audit")))

    def told(content):
        write_json(tmp_path / "audit.json", content)
        more = {"audit": tmp_path / "audit.json", "margins": tmp_path / "margins.parquet"}
        given = ReportFiles(**example.arguments(folder), **more)
        report.run(case, given, tmp_path / "report.html", tmp_path / "summary.json")
        return page(tmp_path), example.read_json(tmp_path / "summary.json")

    shown, summary = told(audit)
    assert shown.figures == 6  # and the map of the margins
    assert (
        "Adversary: 0 violations in 5,678 single steps that attack the bound and 5,555 closed-loop steps" in shown.text
    )
    assert "An adversary found no violation in 11,233 attempts." in shown.text
    assert "7 are lost to gamma, 1 is lost to cells." in shown.text
    assert (
        "The worst step found (at x1 = -0.2 rad, x2 = 0.5 rad/s) lies inside the bound by 25 % of its width."
        in shown.text
    )
    assert "promise kept" in shown.text
    assert summary["audit"] == {
        "evaluations": 5678, "steps": 1234, "steps_against_the_disturbance": 4321, "violations": 0,
        "largest_share": -0.25, "witnesses": [],
    }  # fmt: skip
    assert summary["margins"]["factor"]["five_percent"] == 2.25
    shown, summary = told(audit | {"violations": 2, "witnesses": ["a step lies outside"]})
    assert "promise broken" in shown.text
    assert summary["promise_kept"] is False


def test_the_index_links_every_case(pendulum, robot, tmp_path):
    summaries = []
    for name, folder in (("pendulum", pendulum[0]), ("robot", robot)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_bytes((folder / "summary.json").read_bytes())
        summaries.append(tmp_path / name / "summary.json")
    pixel = b"\x89PNG made up"
    (tmp_path / "robot/picture.png").write_bytes(pixel)
    found = example.read_json(summaries[0]) | {"diagnosis": "attributed"}
    later = found | {"winning_fraction": {"gap": 0.8125, "nominal": 0.7}}
    write_json(summaries[0], found)
    write_json(tmp_path / "pendulum/corrected/summary.json", later)
    content = example.read_json(summaries[1])
    fair = {"simulator": content["closed_loop"]["gap"]["simulator"] | {"runs_that_kept_the_specification": 1}}
    write_json(summaries[1], content | {"closed_loop": content["closed_loop"] | {"baseline": fair}})
    index.run(summaries, tmp_path / "index.html")
    shown = Page((tmp_path / "index.html").read_text())
    assert {"pendulum/report.html", "robot/report.html"} <= set(shown.addresses)
    assert {"pendulum/corrected/report.html", "pendulum/diagnosis/corrected_case.yaml"} <= set(shown.addresses)
    assert f"data:image/png;base64,{base64.b64encode(pixel).decode()}" in shown.addresses
    assert "A robot among obstacles" in shown.text
    assert re.search(r"corrected\s*kept.*81\.2 %", shown.text)
    assert "1 of 2 fair baseline" in shown.text
    size = content["sup_gamma"][0]["states"]["heading"]["size"]
    assert f"heading {number(size, 3)} rad" in shown.text


def test_a_summary_of_another_version_is_named(pendulum, tmp_path):
    content = example.read_json(pendulum[0] / "summary.json")
    del content["closed_loop"]
    write_json(tmp_path / "old/summary.json", content)
    with pytest.raises(UserError, match=r"old/summary\.json: .*another version"):
        index.run([tmp_path / "old/summary.json"], tmp_path / "index.html")
    index.run([], tmp_path / "index.html", [tmp_path / "old/summary.json"])
    assert "old/report.html" not in (tmp_path / "index.html").read_text()


def test_figures_are_files_too(pendulum, tmp_path):
    folder, case = pendulum
    made = {"out": tmp_path / "report.html", "figures_out": tmp_path / "summary.json"}
    report.run(
        case, ReportFiles(**example.arguments(folder)), **made, picture=tmp_path / "p.png", folder=tmp_path / "f"
    )
    names = {path.name for path in (tmp_path / "f").iterdir()}
    assert {"problem.svg", "domains.svg", "trajectories.svg", "gap.svg", "bound.png"} == names
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "report.html").read_text()
    assert (tmp_path / "f/gap.svg").read_text()[50:3000] in text


def test_the_fair_baseline_is_told(robot, tmp_path):
    content = example.read_json(robot / "validation/validation.json")
    tally = content["controllers"]["gap"]["simulator"] | {"steps_that_left_the_certified_box": 7}
    content["controllers"]["baseline"] = {"simulator": tally}
    write_json(tmp_path / "validation.json", content)
    given = example.arguments(robot) | {"validation": tmp_path / "validation.json"}
    report.run(robot / "case.yaml", ReportFiles(**given), tmp_path / "report.html", tmp_path / "summary.json")
    text = page(tmp_path).text
    assert "between samples): 2 of 2 runs in the target without touching anything, 7 of 60 steps outside" in text
    assert any("Fair baseline" in s for s in example.read_json(tmp_path / "summary.json")["verdict"])


def test_a_missing_result_is_named(pendulum, tmp_path):
    folder, case = pendulum
    given = example.arguments(folder) | {"traces": tmp_path / "traces.parquet"}
    with pytest.raises(UserError, match=r"traces\.parquet.*does not exist"):
        report.run(case, ReportFiles(**given), tmp_path / "report.html", tmp_path / "summary.json")
    assert not (tmp_path / "report.html").exists()


def test_the_contents_link_every_section(pendulum):
    text = (pendulum[0] / "report.html").read_text()
    places = re.findall(r'<section id="([^"]+)">\s*<h2>', text)
    contents = re.search(r'<nav class="contents"[^>]*>(.*?)</nav>', text)
    assert re.findall(r'href="#([^"]+)"', contents[1]) == places
    assert len(set(places)) == text.count("<h2>") > 8
