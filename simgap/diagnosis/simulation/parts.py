"""The problems of the three folds: fit and choose, together what the search knows, and confirm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Span, left_out
from simgap.diagnosis.simulation.colour import Colour
from simgap.diagnosis.simulation.problem import Problem


@dataclass(frozen=True, eq=False)
class Parts:
    """One record as four problems.

    Attributes:
        known: the windows of `fit` and of `choose`, which the search sees.
        fit, choose: effects fitted to the one are judged on the other, where sets of them compete.
        confirm: windows that are judged once, at the end.
    """

    known: Problem
    fit: Problem
    choose: Problem
    confirm: Problem

    def past_the_unknown(self, reach_s: float) -> Parts:
        """The same without the samples on which commands from before the record may still act."""
        return self.changed(lambda p: p.past_the_unknown(reach_s))

    def before_the_end(self, late_s: float) -> Parts:
        """The same without the end of each trace, where what acted was logged after its last sample."""
        return self.changed(lambda p: p.before_the_end(late_s))

    def leaving_out(self, spans: tuple[Span, ...]) -> Parts:
        """The same without those times in what is fitted and in what chooses; what confirms is kept whole."""
        if not spans:
            return self
        known, fit, choose = (p.on(left_out(p.windows, p.t, spans)) for p in (self.known, self.fit, self.choose))
        return Parts(known, fit, choose, self.confirm)

    def changed(self, change: Callable[[Problem], Problem]) -> Parts:
        """Each of the problems, changed."""
        return Parts(*(change(p) for p in (self.known, self.fit, self.choose, self.confirm)))

    def with_noise(self, size: Floats, colour: Colour) -> Parts:
        """The same under another law of the noise, its standard deviation (k,) over that of before."""
        return Parts(
            *(
                replace(p, sigma=p.sigma * size, colour=colour)
                for p in (self.known, self.fit, self.choose, self.confirm)
            )
        )

    def without(self, channels: Bools) -> Parts:
        """The same with some of the channels (k,) left out of every fit."""
        heard = np.where(channels, 0.0, self.known.heard)
        return self.changed(lambda p: replace(p, heard=heard))
