"""One look for every picture: a palette that colour-blind people can read, quiet axes, the same bytes every time."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from markupsafe import Markup

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
    """Matplotlib in the style of the reports, inside the block."""
    import matplotlib

    with matplotlib.rc_context(fname=str(folder() / STYLE)):
        yield


def save(figure: Any, target: Any, kind: str, dpi: float | None = None) -> None:
    """The one way out of every figure, `kind` svg or png: what it says is text that can be printed.

    It carries no date and no version, so equal figures are equal bytes. `savefig` would draw it twice, first to lay it
    out; drawing does so too, the first time.
    """
    from matplotlib import rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    text_alone(figure)
    figure.set_dpi(dpi or rcParams["savefig.dpi"])
    canvas: Any = (FigureCanvasSVG if kind == "svg" else FigureCanvasAgg)(figure)
    if kind == "svg":
        canvas.print_svg(target, metadata={"Date": None, "Creator": None})
    else:
        canvas.print_png(target, metadata={"Software": None})
    figure.set_layout_engine("none")


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
    """A figure as an SVG element to put into a page."""
    buffer = io.StringIO()
    save(figure, buffer, "svg")
    text = buffer.getvalue()
    element = text[text.index("<svg") :]
    return Markup(re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'width="100%"', element, count=1))


def drawn(path: Path, figure: Callable[..., Any], *content: Any) -> str:
    """`figure(*content)` drawn once, as its file asks: -> the text of an SVG, which is what a page takes.

    Where it cannot be drawn, a sentence stands in its place, no more is lost.
    """
    text = ""
    try:
        made = figure(*content)
        if path.suffix == ".png":
            with atomic(path) as temporary:
                save(made, temporary, "png")
        else:
            text = svg_text(made)
            write_text(path, text)
        return text
    except Exception as error:  # of the libraries: no number and no verdict rests on a picture
        log.warning("%s could not be drawn: %s", path.name, one_line(f"{type(error).__name__}: {error}"))
        path.unlink(missing_ok=True)
        return Markup('<p class="note">{} could not be drawn; the log says why.</p>').format(path.name)


def panels(rows: int, columns: int, height: float, width: float = WIDTH, **shared: Any) -> tuple[Any, Any]:
    """A figure of a page's width, `height` inches high, and its axes (rows, columns); `shared` as for `subplots`.

    It is none of pyplot's, which would keep it until it is closed.
    """
    from matplotlib.figure import Figure

    figure = Figure((width, height))
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def legend(figure: Any, ncols: int = 6, markerscale: float = 1.0) -> None:
    """A legend above the panels, no wider than they are: each label that something drawn carries, once.

    What carries one label in several colours stands side by side.
    """
    from matplotlib.legend_handler import HandlerTuple

    named: dict[str, dict[str, Any]] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, {}).setdefault(_colour(handle), handle)
    handles = [tuple(looks.values()) for looks in named.values()]
    found = figure.legend(
        handles, list(named), loc="outside upper left", ncols=ncols, columnspacing=1.0, markerscale=markerscale,
        handler_map={tuple: HandlerTuple(None)},
    )  # fmt: skip
    if ncols > 1 and found.get_window_extent().width > _LEGEND * figure.bbox.width:
        found.remove()
        legend(figure, ncols - 1, markerscale)


def _colour(handle: Any) -> str:
    first = handle[0] if isinstance(handle, tuple) else handle  # of a container
    return str(first.get_color() if hasattr(first, "get_color") else first.get_facecolor())
