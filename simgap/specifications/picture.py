"""Pictures of a specification: boxes over two states, and the floor of a body that drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.geometry import Box


@dataclass(frozen=True)
class Look:
    """Colours of matplotlib for what is to be reached (face, edge), avoided, and never left."""

    target: tuple[str, str]
    obstacle: str
    border: str


@dataclass(frozen=True, eq=False)
class Plane:
    """A floor seen from above.

    Attributes:
        axes: which states are x, y and heading.
        arena, target, obstacles: boxes over (x, y), no target where nothing is to be reached; radius: of the
            footprint, in the unit of x.
    """

    axes: tuple[int, int, int]
    arena: Box
    target: Box | None
    obstacles: tuple[Box, ...]
    radius: float


def projected(box: Box, outer: Box, shown: tuple[int, int]) -> Box:
    """A box over two of its states, cut at `outer` where it has no end."""
    i = list(shown)
    return Box(
        np.where(np.isfinite(box.lo[i]), box.lo[i], outer.lo[i]),
        np.where(np.isfinite(box.hi[i]), box.hi[i], outer.hi[i]),
    )


def rectangle(axes: Any, box: Box, **look: Any) -> None:
    """A box over two states as a patch."""
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((box.lo[0], box.lo[1]), *(box.hi - box.lo), **look))
