"""The winning domains as an image, with the runs on display in it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.content import Content
from simgap.io.rerun.log import TIMELINE, rgb
from simgap.io.traces import NOMINAL, ROBUST, TITLES
from simgap.synthesis.controller import Controller

PIXELS = 800  # along the longer side, at least
NEITHER, BOTH = "#FFFFFF", "#C9D3DC"


def on_plane(controller: Controller) -> Floats:
    """Share of the cells above each point of the plane of the first two states that win: (c0, c1)."""
    winning = controller.solution.winning.reshape(controller.grid.cells)
    return winning.reshape(*winning.shape[:2], -1).mean(axis=2)


def domains_image(robust: Controller, nominal: Controller) -> NDArray[np.uint8]:
    """Where each controller wins, as colours: (c1, c0, 3), second state upward.

    More than two states: where it wins for every value of the others.
    """
    a, b = on_plane(robust) >= 1.0, on_plane(nominal) >= 1.0
    image = np.empty((*a.shape, 3), np.uint8)
    for chosen, colour in ((~a & ~b, NEITHER), (a & b, BOTH), (a & ~b, COLOURS[ROBUST]), (~a & b, COLOURS[NOMINAL])):
        image[chosen] = rgb(colour)[:3]
    return np.ascontiguousarray(image.transpose(1, 0, 2)[::-1])


def to_pixels(x: Floats, box: Box, shape: tuple[int, int]) -> Floats:
    """States (n, >= 2) in the coordinates of an image of (height, width) that shows `box`: (n, 2)."""
    height, width = shape
    scaled = (x[:, :2] - box.lo[:2]) / (box.hi[:2] - box.lo[:2])
    return np.stack([scaled[:, 0] * width, (1.0 - scaled[:, 1]) * height], axis=1)


def log_phase(recording: Any, content: Content) -> None:
    """Log the image and the runs; nothing for plants with one state, or grids that differ."""
    import rerun as rr

    robust, nominal = content.controllers[ROBUST], content.controllers[NOMINAL]
    if len(content.states) < 2 or robust.grid.cells != nominal.grid.cells:
        return
    image = domains_image(robust, nominal)
    repeat = max(1, PIXELS // max(image.shape[:2]))
    image = image.repeat(repeat, axis=0).repeat(repeat, axis=1)
    recording.log("phase/winning_domains", rr.Image(image), static=True)
    size = 0.004 * max(image.shape[:2])
    for controller, trace in content.shown.items():
        points = to_pixels(trace.x, robust.grid.box, image.shape[:2])
        name, colour = f"phase/{controller}", rgb(COLOURS[controller])
        if controller == ROBUST:
            colour = rgb("#00436B")
        recording.log(f"{name}/path", rr.LineStrips2D([points], colors=colour, radii=0.35 * size), static=True)
        look = rr.Points2D.from_fields(colors=rgb(style.BLACK), radii=1.6 * size, labels=TITLES[controller])
        recording.log(f"{name}/state", look, static=True)
        recording.send_columns(
            f"{name}/state", [rr.TimeColumn(TIMELINE, duration=trace.t)], rr.Points2D.columns(positions=points)
        )
