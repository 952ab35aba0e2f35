"""What a browser makes of the pages: nothing overflows, on a desk or a phone, in the light or the dark; no errors."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from simgap.stages import diagnosis, index, report
from simgap.stages.report import ReportFiles
from tests.stages import loop_example as example

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
LOOK = """<!DOCTYPE html><body><script>
const frame = document.createElement("iframe");
frame.style = "border: 0; height: 900px; width: WIDTHpx"; frame.src = "PAGE";
frame.onload = () => {
  const page = frame.contentDocument, wide = frame.clientWidth;
  const scrolls = e => { for (; e; e = e.parentElement) if (getComputedStyle(e).overflowX == "auto") return true; };
  const over = [...page.body.querySelectorAll("*")].filter(
    e => e.getBoundingClientRect().right > wide + 1 && !scrolls(e)).map(e => e.tagName);
  const unsaid = [...page.querySelectorAll("figure")].filter(
    f => !f.querySelector("figcaption")?.textContent.trim() ||
      !f.querySelector("[aria-label], img[alt]:not([alt=''])")).concat(
    [...page.querySelectorAll("img:not([alt]), img[alt='']")]);
  const found = {over, unsaid: unsaid.length, figures: page.querySelectorAll("figure").length,
    cut: [...page.querySelectorAll(".scroll")].filter(e => e.scrollWidth > e.clientWidth + 1).map(
      e => getComputedStyle(e, "::before").content.includes("more columns")),
    explored: page.querySelectorAll("#explorer .subplot").length,
    ground: getComputedStyle(page.body).backgroundColor, scroll: page.documentElement.scrollWidth - wide};
  document.body.innerHTML = "<pre>" + JSON.stringify(found) + "</pre>";
};
document.body.append(frame);
</script></body>"""


@pytest.fixture(scope="module")
def page(tmp_path_factory, root) -> Path:
    folder = tmp_path_factory.mktemp("page")
    case = example.pendulum(root, folder)
    made = {"out": folder / "report.html", "figures_out": folder / "summary.json", "picture": folder / "picture.png"}
    report.run(case, ReportFiles(**example.arguments(folder)), **made)
    index.run([folder / "summary.json"], folder / "index.html")
    return folder


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory, root) -> Path:
    folder = tmp_path_factory.mktemp("diagnosed")
    diagnosis.run(root / "docs/tutorial/rod.yaml", (), folder)
    return folder


def look(folder: Path, width: int, *more: str, page: str = "report.html") -> tuple[dict, str]:
    """What the browser finds on the page at a width, and what it says on its console."""
    (folder / "look.html").write_text(LOOK.replace("WIDTH", str(width)).replace("PAGE", page))
    call = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", *more]
    call += [f"--user-data-dir={folder / 'profile'}", "--window-size=1300,1000", "--virtual-time-budget=5000"]
    call += ["--enable-logging=stderr", "--dump-dom", (folder / "look.html").as_uri()]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=True)
    said = re.search(r"<pre>(\{.*\})</pre>", done.stdout)
    assert said is not None, done.stdout[:500]
    return json.loads(said[1]), "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


@pytest.mark.parametrize("width", [1100, 390])
def test_nothing_overflows_and_every_figure_is_described(page, width):
    found, console = look(page, width)
    assert found["over"] == []
    assert found["scroll"] <= 0
    assert found["figures"] >= 4
    assert found["unsaid"] == 0
    assert all(found["cut"])
    assert bool(found["cut"]) == (width == 390), "a phone is told of the columns that it does not show"
    assert found["explored"] == 4, "two states and their gaps, drawn by the script of the page"
    assert console == ""


def test_what_is_explored_is_plain_data_without_numbers_that_json_lacks(page):
    text = (page / "report.html").read_text()
    given = re.search(r'<script type="application/json" id="explorer-data">(.*?)</script>', text, flags=re.S)
    runs = json.loads(given[1], parse_constant=pytest.fail)
    assert [line["yaxis"] for line in runs["data"] if line["name"] == "gap"] == ["y2", "y4"]
    for low, high, gap in zip(
        *[iter([r for r in runs["data"] if "only" not in r["name"] and "aware" not in r["name"]])] * 3, strict=True
    ):
        assert all(a <= d <= b for a, d, b in zip(low["y"], gap["y"], high["y"], strict=True))


@pytest.mark.parametrize("width", [1100, 390])
def test_the_index_fits_too(page, width):
    found, console = look(page, width, page="index.html")
    assert found["over"] == []
    assert found["scroll"] <= 0
    assert found["unsaid"] == 0
    assert console == ""


@pytest.mark.parametrize("width", [1100, 390])
def test_a_diagnosis_fits_and_is_explored(diagnosed, width):
    found, console = look(diagnosed, width)
    assert found["over"] == []
    assert found["scroll"] <= 0
    assert found["unsaid"] == 0
    assert found["explored"] == 1, "the angle, drawn by the script of the page"
    assert console == ""


def test_the_page_is_dark_where_the_reader_prefers_it(page):
    light, dark = (look(page, 1100, *more)[0]["ground"] for more in ((), ("--force-dark-mode",)))
    assert (light, dark) == ("rgb(246, 247, 249)", "rgb(20, 23, 28)")
