"""HTML pages from templates: one self-contained file each, with the style inside.

The templates stand in `reports/` of a checkout; a wheel carries them as `simgap/templates`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from simgap import reading
from simgap.errors import UserError
from simgap.notation import interval, number, powers, pretty_unit, printable

STYLE = "style.css"
NO_CONTROLLER = "no_controller.html"
"""Page of a run that ends without a controller; the page of a case takes its place, and it that of the page."""
_PACKAGED, _CHECKOUT = (reading.real(Path(__file__)).parents[k] / n for k, n in ((1, "templates"), (2, "reports")))


def folder() -> Path:
    """Folder of the templates."""
    return _PACKAGED if _PACKAGED.is_dir() else _CHECKOUT


def need_template(template: str) -> None:
    """Make sure of a template and the style before anything long is begun.

    Raises:
        UserError: one of them is not there.
    """
    for name in (template, STYLE):
        if not reading.is_file(folder() / name):
            remedy = "Install simgap again, whole."
            raise UserError("the template of the page is missing", file=folder() / name, remedy=remedy)


def described(picture: str, alt: str) -> str:
    """A figure (an SVG or image element) with its alternative text, for who cannot see it."""
    text = str(picture)
    if text.startswith("<img"):
        return Markup(text.replace('alt=""', f'alt="{escape(alt)}"', 1))
    return Markup(text.replace("<svg", f'<svg role="img" aria-label="{escape(alt)}"', 1))


def script_data(content: Any) -> str:
    """Plain data as JSON that can stand in a script element."""
    return Markup(json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def library(name: str) -> str:
    """A script of `reports/`, whole, to stand in a page."""
    return Markup(reading.read_text(folder() / name))


def render(template: str, **content: Any) -> str:
    """A page from a template, printable; figures given as SVG text are put in as they are, all else is escaped."""
    from simgap.diagnosis.verdict.words import phrase

    environment = _environment(autoescape=True)
    filters = {f.__name__: f for f in (number, interval, powers, phrase, described, script_data)}
    environment.filters |= filters | {"unit": pretty_unit}
    environment.globals["library"] = library
    style = Markup(reading.read_text(folder() / STYLE))  # quotes of font names must stay quotes
    return _with_contents(printable(environment.get_template(template).render(style=style, **content)))


_SECTION = re.compile(r'<section(?: id="([\w-]+)")?>\s*<h2>(.*?)</h2>')


def _with_contents(page: str) -> str:
    """The page with links to its sections in its contents, if it has a place for them."""
    head, mark, rest = page.partition('<nav class="contents" aria-label="Contents">')
    links: list[str] = []

    def named(found: re.Match[str]) -> str:
        place, title = found[1] or f"part-{len(links)}", found[2]
        links.append(f'<a href="#{place}">{title}</a>')
        return f'<section id="{place}">\n  <h2>{title}</h2>'

    rest = _SECTION.sub(named, rest)
    return "".join([head, mark, *links, rest])


def text(template: str, **content: Any) -> str:
    """A plain text from a template."""
    environment = _environment(keep_trailing_newline=True)  # no escapes: what is made is no HTML
    return environment.get_template(template).render(**content)


def _environment(**options: Any) -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(folder())
    return Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options)
