"""Pages: files that they name are there, no page is too long to read, and their tables are those of the results."""

import importlib.util
import json
import re
import sys

import pytest

LINES, PARAGRAPH, ITEM = 250, 90, 60
GENERATED = ("effects.md", "keys_stages.md", "keys_system.md")


def pages(root):
    return [root / "README.md", root / "CONTRIBUTING.md", root / "config/README.md", *sorted(root.glob("docs/**/*.md"))]


@pytest.fixture
def tables(root, monkeypatch):
    monkeypatch.syspath_prepend(str(root / "benchmarks"))
    spec = importlib.util.spec_from_file_location("documented_tables", root / "benchmarks/tables.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def blocks(text):
    """Paragraphs, items of lists and cells of tables: their kind and words, without code and comments."""
    kind, words = "", []
    for line in [*re.sub(r"```.*?```|<!--.*?-->", "", text, flags=re.S).splitlines(), ""]:
        cells = re.match(r"\s*\|(.*)\|\s*$", line)
        item = re.match(r"\s*(?:\d+\.|[-*])\s+(.*)", line)
        if cells or item or not line.strip() or line.startswith("#"):
            if words:
                yield kind, words
            kind, words = "", []
        if cells:
            yield from (("cell", cell.split()) for cell in re.split(r"(?<!\\)\|", cells[1]))
        elif item:
            kind, words = "item", item[1].split()
        elif line.strip() and not line.startswith("#"):
            kind, words = kind or "paragraph", words + line.split()


def test_no_page_is_too_long_to_read(root):
    limits = {"paragraph": PARAGRAPH, "item": ITEM, "cell": ITEM}
    long = []
    for path in pages(root):
        text = path.read_text()
        if len(text.splitlines()) > LINES:
            long.append((path.name, len(text.splitlines()), "lines"))
        if path.name not in GENERATED:
            long += [(path.name, len(w), " ".join(w[:8])) for kind, w in blocks(text) if len(w) > limits[kind]]
    assert long == []


def test_a_long_item_is_seen():
    text = "1. one\n   two\n\nthree four\n\n| five | six |\n|---|---|\n\n```\nnot this\n```\n- seven"
    found = [(kind, len(words)) for kind, words in blocks(text) if kind != "cell"]
    assert found == [("item", 2), ("paragraph", 2), ("item", 1)]


def test_every_file_that_is_named_is_there(root):
    texts = [*pages(root), root / "Snakefile", *root.glob("simgap/**/*.py"), *root.glob("rules/*.smk"),
             *root.glob("reports/*.j2"), *root.glob("benchmarks/*.py")]  # fmt: skip
    pattern = r"\b(?:configs/[\w./-]+\.(?:yaml|json|urdf|xml)|docs/[\w./-]+\.(?:md|ipynb|png))\b"
    named = {(str(path.relative_to(root)), name) for path in texts for name in re.findall(pattern, path.read_text())}
    assert len(named) > 20
    assert [pair for pair in sorted(named) if not (root / pair[1]).is_file()] == []


def test_every_link_leads_to_a_file_of_the_repository(root):
    """The site checks its own links; a person reads these pages in the repository too."""
    texts = {
        path: re.sub(r"```.*?```", "", path.read_text(), flags=re.S) for path in [*pages(root), root / "CHANGELOG.md"]
    }
    links = [(p, link) for p, text in texts.items() for link in re.findall(r"\]\((?!https?:)([^)#\s]+)", text)]
    assert len(links) > 100
    assert [(p.name, link) for p, link in links if not (p.parent / link).exists()] == []


def test_axe_finds_no_violation_on_a_page_of_any_kind(root):
    """CHANGELOG says so, and every template of a page has been looked at (`benchmarks/accessibility.py`)."""
    looked = json.loads((root / "benchmarks/results/accessibility.json").read_text())["pages"]
    kinds = {"case", "diagnosis", "arm_diagnosis", "index", "sweep", "nothing_wins"}
    assert set(looked) >= kinds
    templates = [p for p in root.glob("reports/*.html.j2") if "extends" in p.read_text().splitlines()[0]]
    assert len(templates) == len(kinds)
    for rows in looked.values():
        assert {(row["width"], row["scheme"]) for row in rows} == {
            (w, s) for w in (1400, 390) for s in ("light", "dark")
        }
        assert [row["violations"] for row in rows] == [{}] * 4
        assert max(row["pixels_beyond"] for row in rows) <= 0


def test_tables_are_those_of_the_results(root, tables):
    compared = 0
    for path in pages(root):
        text = path.read_text()
        compared += sum(tables.made(name) is not None for name in re.findall(r"<!-- table (\w+) -->", text))
        assert tables.filled(text) == text, f"{path.name}: run `python benchmarks/tables.py`"
    assert compared >= 20


def test_figures_in_sentences_are_those_of_the_results(root):
    def results(name):
        return json.loads((root / f"benchmarks/results/{name}.json").read_text())

    def page(name):
        return " ".join((root / name).read_text().split())

    outside = [
        r for r in results("outside_library") if r["kind"] not in ("soft stop", "square spring")
    ]  # curves are in
    partial = sum(r["verdict"] == "partial" for r in outside)
    for name in ("README.md", "docs/explanation/diagnosis.md"):
        assert f"{partial} were `partial`" in page(name), name
        assert f"Of {len(outside)} recordings" in page(name), name
    assert sum(r["verdict"] == "attributed" and bool(r["other"]) for r in outside) == 1
    assert f"{sum(r['verdict'] == 'unexplained' for r in outside)} were `unexplained`" in page("README.md")
    assert "one was wrongly `attributed`" in page("docs/explanation/diagnosis.md")
    assert f"{partial} of {len(outside)} are `partial`" in page("docs/evidence/diagnosis.md")
    quoted = {"pendulum": ("691 of 980", "1,000 of 1,000"), "turtlebot": ("993 of 1,000",),
              "diagnosis": ("0.0099 ± 0.0006 N m s/rad", "0.0050 ± 0.0003 N m s²/rad²")}  # fmt: skip
    for name, figures in quoted.items():
        for figure in figures:
            assert figure in page("README.md"), figure
            assert figure in page(f"docs/evidence/{name}.md"), (name, figure)


def test_numbers_of_the_code_in_sentences_are_those_of_the_code(root):
    from simgap.correction import corrected_case
    from simgap.effects import EFFECTS

    def page(name):
        return " ".join((root / name).read_text().split())

    assert 30 <= len(EFFECTS) < 40
    assert "some thirty physical effects" in page("README.md")
    assert (corrected_case.LARGEST_ROLLOUTS, corrected_case.LARGEST_PAIRS) == (2_000_000, 100_000_000)
    assert "two million roll-outs and a hundred million pairs" in page("docs/how-to/corrected_case.md")
    found = json.loads((root / "benchmarks/results/tampering.json").read_text())
    counts = found["counts"].items()
    false = sum(n for what, n in counts if what.endswith("/ false"))
    accepted = sum(n for what, n in counts if "/ accepted /" in what)
    assert found["findings"] == []
    assert (
        f"of {found['changes']}, {false} are false at some point, and all of those are rejected. {accepted} that"
        in (page("docs/how-to/certificate.md"))
    )


def test_known_weaknesses_are_those_of_the_study(root):
    records = json.loads((root / "benchmarks/results/undeclared.json").read_text())["records"]
    text = " ".join((root / "docs/evidence/diagnosis.md").read_text().split())

    def hidden(kind):
        return [r for r in records if kind in {name for name, _ in r["truth"]}]

    peaks = [r for r in records if r["study"] == "alike: small Stribeck peak"]
    missed = [r for r in peaks if not r["exact"]]
    weak = [r for r in hidden("input_delay") if r["verdict"] == "partial"]
    springs = [r for r in hidden("spring") if r["verdict"] != "attributed"]
    small = [r for r in records if r["verdict"] == "none" and r["truth"]]
    parts = [r for r in records if r["verdict"] == "attributed" and not r["exact"]]
    peak, lag = ([r for r in parts if r["answer"] == [[name, on]]] for name, on in (
        ("coulomb_friction", "hinge"), ("input_lag", "torque")))  # fmt: skip
    assert all("stribeck_friction" in {n for n, _ in r["truth"]} for r in peak)
    assert all({n for n, _ in r["truth"]} == {"input_delay", "input_lag"} for r in lag)
    assert f"named in {len(peaks) - len(missed)} of {len(peaks)} records" in text
    assert f"and {sum(r['listed'] for r in missed)} of these list the peak" in text
    assert [len(weak), len(springs), len(small)] == [11, 9, 0]
    for words in ("Eleven delays are `partial`", "Nine records hide a spring"):
        assert words in text, words
    assert len(peak) + len(lag) == len(parts)
    assert f"in {len(parts)} `attributed` answers of these {len(records)} records" in text
    assert f"Stribeck peak ({len(peak)}, " in text
    assert f"a lag with a delay ({len(lag)})" in text
    covered = [c for r in records for c in r["covered"]]
    assert f"{100 * sum(covered) / len(covered):.1f} % of the 95 % intervals" in text


def test_the_tutorial_quotes_its_run(root):
    found = json.loads((root / "benchmarks/results/tutorial.json").read_text())
    page, readme = ((root / name).read_text() for name in ("docs/tutorials/robot.md", "README.md"))
    gap = " | ".join(f"{found[when]['largest_gap']:.2g}".replace("2.8e-05", "0.000028") for when in ("before", "after"))
    assert gap in page
    for kind in ("nominal", "gap"):
        row = " | ".join("{} of {}".format(*found[when]["failed"][kind]) for when in ("before", "after"))
        assert f"| {row} |" in page, kind
    assert " | ".join(f"{100 * found[when]['winning']['gap']:.1f} %" for when in ("before", "after")) in page
    failed, runs = found["before"]["failed"]["nominal"]
    assert f"fails in {failed} of {runs} runs" in readme


def test_the_way_of_a_sample_names_functions_that_are_there(root):
    text = (root / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`([\w/]+\.py):(\w+)`", text[text.index("## One sample") : text.index("## How code is")])
    assert len(named) > 15
    for path, function in named:
        assert re.search(rf"^(\s*)def {function}\b", (root / "simgap" / path).read_text(), re.M), (path, function)
