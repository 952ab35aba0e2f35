"""The site of docs/ builds without a warning, lists what the package says, and opens without a network."""

import ast
import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest

pytest.importorskip("mkdocs")


@pytest.fixture(scope="module")
def site(root, tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    call = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)]
    done = subprocess.run(call, cwd=root, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


class Loaded(HTMLParser):
    """Everything that a page loads by itself."""

    def __init__(self, text):
        super().__init__()
        self.addresses = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        own = dict(attrs)
        if tag in ("script", "img", "iframe", "source"):
            self.addresses.append(own.get("src"))
        elif tag == "link" and own.get("rel") not in ("canonical", "next", "prev"):
            self.addresses.append(own.get("href"))


def test_every_page_opens_without_a_network(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        for address in Loaded(page.read_text()).addresses:
            assert address is None or not re.match(r"https?:|//", address), (page.name, address)


def test_a_bar_in_a_cell_has_no_backslash(site):
    """The formula of Coulomb friction read "any \\|F\\| <= F_c"."""
    text = (site / "reference/effects.html").read_text()
    assert "any |F| &lt;= F_c" in text
    assert r"\|" not in "".join(re.findall(r"<td.*?</td>", text, re.DOTALL))


def test_every_link_within_the_site_leads_to_a_place(site):
    places = {page: set(re.findall(r'\bid="([^"]+)"', page.read_text())) for page in site.rglob("*.html")}
    for page in places:
        for link in re.findall(r'<a [^>]*href="([^":]*#[^"]+)"', page.read_text()):
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            assert anchor in places[target], (page.name, link)


def test_the_first_page_is_the_readme(site, root):
    text = (site / "index.html").read_text()
    assert "measures how far a robot" in text
    assert 'href="tutorials/robot.html"' in text
    assert (site / "pictures/diagnosis.png").read_bytes() == (root / "docs/pictures/diagnosis.png").read_bytes()


def test_every_public_name_is_documented(site):
    import simgap

    text = (site / "reference/python.html").read_text()
    for name in simgap.__all__:
        assert re.search(rf'id="simgap\.[\w.]*{name}"', text), name


def test_messages_are_those_of_the_package(site, root):
    text = (site / "reference/messages.html").read_text()
    assert "no recording here" in text or "does not exist" in text
    source = ast.parse((root / "simgap/stages/index.py").read_text())
    assert any(isinstance(n, ast.Constant) and n.value == "the summary is of another version" for n in ast.walk(source))
    assert "the summary is of another version" in text


def test_every_key_and_effect_is_on_the_site(site):
    assert "validation.fair_baseline" in (site / "reference/keys_stages.html").read_text()
    assert "coulomb_friction" in (site / "reference/effects.html").read_text()
