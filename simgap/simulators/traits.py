"""What an engine does with parts of a model file that cannot be asked of it once it is loaded."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileTraits:
    """Of an engine that loads a URDF; tests show each in the engine itself.

    Attributes:
        stops: whether a joint stops at the ends of its range.
        damps_links: whether it damps the motion of links on its own (`simulator.damping`).
        fastest: the speed at which it cuts every joint, rad/s or m/s; None if it does not.
    """

    stops: bool = True
    damps_links: bool = False
    fastest: float | None = None
