"""The problems of the three folds: fit and choose, together what the search knows, and confirm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Span, cut_at, left_out
from simgap.diagnosis.simulation.colour import Colour
from simgap.diagnosis.simulation.problem import Problem


@dataclass(frozen=True, eq=False)
class Parts:
    """One record as four problems.

    Attributes:
        known: the windows of `fit` and of `choose`, which the search sees.
        fit, choose: effects fitted to the one are judged on the other, where sets of them compete.
        confirm: windows that are judged once, at the end.
        left_out: times that were cut out of the others, where gross errors follow one another.
    """

    known: Problem
    fit: Problem
    choose: Problem
    confirm: Problem
    left_out: tuple[Span, ...] = ()

    def past_the_unknown(self, reach_s: float) -> Parts:
        """The same without the samples on which commands from before the record may still act."""
        return self.changed(lambda p: p.past_the_unknown(reach_s))

    def before_the_end(self, late_s: float) -> Parts:
        """The same without the end of each trace, where what acted was logged after its last sample."""
        return self.changed(lambda p: p.before_the_end(late_s))

    def with_gross_errors(self, usual: Floats, spans: tuple[Span, ...]) -> Parts:
        """The same where misses much larger than a usual one (k,) are gross errors that weigh nothing.

        Fitted windows are cut where such errors were seen to begin and to end: each part has an initial state.
        """
        parts = self.changed(lambda p: replace(p, usual=usual))
        known, fit, choose = (p.on(cut_at(p.windows, p.t, spans)) for p in (parts.known, parts.fit, parts.choose))
        return replace(parts, known=known, fit=fit, choose=choose)

    def leaving_out(self, spans: tuple[Span, ...]) -> Parts:
        """The same without those times in what is fitted and in what chooses; what confirms is kept whole."""
        known, fit, choose = (p.on(left_out(p.windows, p.t, spans)) for p in (self.known, self.fit, self.choose))
        return replace(self, known=known, fit=fit, choose=choose, left_out=spans)

    def under_the_law_of(self, other: Parts) -> Parts:
        """The same without the times that another left out, and with its law of gross errors."""
        parts = self.leaving_out(other.left_out) if other.left_out else self
        return parts if other.known.usual is None else parts.with_gross_errors(other.known.usual, ())

    def changed(self, change: Callable[[Problem], Problem]) -> Parts:
        """Each of the problems, changed."""
        known, fit, choose, confirm = (change(p) for p in (self.known, self.fit, self.choose, self.confirm))
        return Parts(known, fit, choose, confirm, self.left_out)

    def with_noise(self, size: Floats, colour: Colour) -> Parts:
        """The same under another law of the noise, its standard deviation (k,) over that of before."""
        return self.changed(lambda p: replace(p, sigma=p.sigma * size, colour=colour))

    def without(self, channels: Bools) -> Parts:
        """The same with some of the channels (k,) left out of every fit."""
        heard = np.where(channels, 0.0, self.known.heard)
        return self.changed(lambda p: replace(p, heard=heard))
