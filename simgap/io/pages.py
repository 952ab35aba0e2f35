"""HTML pages from templates in `reports/`: one self-contained file each, with the style inside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simgap.diagnosis.verdict.words import phrase
from simgap.notation import number, pretty_unit

REPORTS = Path(__file__).resolve().parents[2] / "reports"


def render(template: str, **content: Any) -> str:
    """A page from `reports/<template>`; figures given as SVG text are put in as they are, all else is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(REPORTS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "unit": pretty_unit, "phrase": phrase}
    style = Markup((REPORTS / "style.css").read_text())  # quotes of font names must stay quotes
    return environment.get_template(template).render(style=style, **content)
