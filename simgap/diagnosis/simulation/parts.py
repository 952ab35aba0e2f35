"""The problems of the three folds: fit and choose, together what the search knows, and confirm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.windows import Windows
from simgap.diagnosis.simulation.colour import Colour
from simgap.diagnosis.simulation.problem import Problem


@dataclass(frozen=True, eq=False)
class Parts:
    """One record as four problems.

    Attributes:
        known: the windows of `fit` and of `choose`, which the search sees.
        fit, choose: effects fitted to the one are judged on the other, where sets of them compete.
        confirm: windows that are judged once, at the end.
        aside: windows that the search does not see, as something else acts in them; None: there are none.
    """

    known: Problem
    fit: Problem
    choose: Problem
    confirm: Problem
    aside: Windows | None = None

    def set_aside(self, out: NDArray[np.bool_]) -> Parts:
        """The same without some windows of `known` (w,); a fold that would be empty keeps its own."""
        gone = self.known.windows.pick(out)

        def calm(p: Problem) -> Problem:
            left = p.windows.pick(~np.isin(p.windows.stop, gone.stop))
            return p.on(left) if len(left) else p

        return Parts(calm(self.known), calm(self.fit), calm(self.choose), self.confirm, gone)

    def past_the_unknown(self, reach_s: float) -> Parts:
        """The same without the samples on which commands from before the record may still act."""
        return self.changed(lambda p: p.past_the_unknown(reach_s))

    def changed(self, change: Callable[[Problem], Problem]) -> Parts:
        """Each of the problems, changed."""
        return replace(
            self,
            known=change(self.known),
            fit=change(self.fit),
            choose=change(self.choose),
            confirm=change(self.confirm),
        )

    def with_noise(self, size: NDArray[np.float64], colour: Colour) -> Parts:
        """The same under another law of the noise, its standard deviation (k,) over that of before."""
        return self.changed(lambda p: replace(p, sigma=p.sigma * size, colour=colour))

    def without(self, channels: NDArray[np.bool_]) -> Parts:
        """The same with some of the channels (k,) left out of every fit."""
        heard = np.where(channels, 0.0, self.known.heard)
        return self.changed(lambda p: replace(p, heard=heard))
