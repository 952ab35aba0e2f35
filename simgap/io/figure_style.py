"""One look for every picture: a palette that colour-blind people can read, quiet axes, the same bytes every time."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from simgap.io.atomic import atomic, write_text
from simgap.io.pages import folder
from simgap.io.traces import BASELINE, GAP_AWARE, NOMINAL
from simgap.notation import one_line, printable, superscript
from simgap.specifications.base import Look

# Okabe & Ito (2008), Color Universal Design
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY = "#8A8F98"
MEASURED, BEFORE, AFTER, FLOOR = BLACK, VERMILLION, BLUE, GREY
MEASURED_IN_A_VIEWER = "#A7AFBB"  # Rerun's is dark unless told otherwise; this is seen on white as well
COLOURS = {GAP_AWARE: BLUE, NOMINAL: VERMILLION, BASELINE: GREEN}  # of the controllers
SURROUNDINGS = Look(target=(YELLOW, "#B8A800"), obstacle="#3A3F47", border="#3A3F47")
WIDTH = 8.6  # inches: 12 pt text stays legible at half of a page's width

_TIMES = r"\times"
_POWER = re.compile(rf"\$\\mathdefault\{{(-?\d*(?:{re.escape(_TIMES)})?)(10)\^\{{(-?\d+)\}}\}}\$")
"""How matplotlib writes a tick of a logarithmic axis."""

log = logging.getLogger(__name__)

STYLE = "figures.mplstyle"
_LEGEND = 0.95  # of a figure's width; letters are wider by up to a twentieth where dots are few


@contextmanager
def figure_style() -> Iterator[None]:
    """Matplotlib without a display, in the style of the reports, inside the block."""
    import matplotlib

    matplotlib.use("Agg", force=False)
    with matplotlib.rc_context(fname=str(folder() / STYLE)):
        yield


def save(figure: Any, target: Any, **options: Any) -> None:
    """The one way out of every figure: what it says is text that can be printed."""
    text_alone(figure)
    figure.savefig(target, **options)


def text_alone(figure: Any) -> None:
    """Make all that a figure says printable, the powers of ten of its axes without formulas."""
    from matplotlib.text import Text

    for axes in figure.axes:
        for ticker in (ticker for axis in (axes.xaxis, axes.yaxis) for ticker in (axis.major, axis.minor)):
            own = ticker.formatter.format_ticks
            ticker.formatter.format_ticks = lambda values, own=own: [_label(text) for text in own(values)]
    for words in figure.findobj(Text):
        words.set_text(printable(words.get_text()))


def _label(text: str) -> str:
    power = _POWER.fullmatch(text)
    if power is None:
        return printable(text)
    factor, base, exponent = (part or "" for part in power.groups())
    return f"{factor.replace(_TIMES, '×')}{base}{superscript(exponent)}"


def svg_text(figure: Any) -> str:
    """A figure as an SVG element to put into a page; it carries no date, so equal figures are equal text."""
    buffer = io.StringIO()
    save(figure, buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    element = text[text.index("<svg") :]
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'width="100%"', element, count=1)


def save_picture(figure: Any, path: Path) -> None:
    """Write a figure as PNG, atomically and without a date or version."""
    with atomic(path) as temporary:
        save(figure, temporary, format="png", metadata={"Software": None})


def kept(figure: Any, path: Path) -> str:
    """A figure drawn once, as its file asks, then freed: -> the text of an SVG, which is what a page takes."""
    text = ""
    if path.suffix == ".png":
        save_picture(figure, path)
    else:
        text = svg_text(figure)
        write_text(path, text)
    close(figure)
    return text


def drawn(make: Callable[[], Any], path: Path) -> str:
    """As `kept`; where a picture cannot be drawn, what stands in its place says so, and nothing else is lost."""
    from markupsafe import escape

    try:
        return kept(make(), path)
    except Exception as error:  # of the libraries: no number and no verdict rests on a picture
        log.warning("%s could not be drawn: %s", path.name, one_line(f"{type(error).__name__}: {error}"))
        path.unlink(missing_ok=True)
        return f'<p class="note">{escape(path.name)} could not be drawn; the log says why.</p>'


def legend(figure: Any, named: Mapping[str, Any], ncols: int) -> None:
    """A legend above the panels, no wider than they are: handles by label, a tuple of them side by side."""
    from matplotlib.legend_handler import HandlerTuple

    found = figure.legend(
        list(named.values()), list(named), loc="outside upper left", ncols=ncols, columnspacing=1.0,
        handler_map={tuple: HandlerTuple(None)},
    )  # fmt: skip
    if ncols > 1 and found.get_window_extent().width > _LEGEND * figure.bbox.width:
        found.remove()
        legend(figure, named, ncols - 1)


def close(figure: Any) -> None:
    """Free a figure."""
    import matplotlib.pyplot as plt

    plt.close(figure)
