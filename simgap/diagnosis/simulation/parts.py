"""From a model and a record to the problems of the three folds: fit and choose, together what the search knows, and
confirm."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from simgap.arrays import Floats
from simgap.diagnosis.record.folds import Span, Windows, cut_at, cut_in_folds, left_out
from simgap.diagnosis.record.noise import worth
from simgap.diagnosis.record.record import MIN_SAMPLES, Record
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.initial import GROWTH, runs_away
from simgap.diagnosis.simulation.problem import Memo, Problem, build_problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.simulation.supermodel import SuperModel, cached_supermodel
from simgap.effects import effect
from simgap.model.symbolic import SymbolicModel


@dataclass(frozen=True, eq=False)
class Parts:
    """One record as four problems.

    Attributes:
        known: the windows of `fit` and of `choose`, which the search sees.
        fit, choose: effects fitted to the one are judged on the other, where sets of them compete.
        confirm: windows that are judged once, at the end.
        window_s: length of the windows, s; horizon_s: how far ahead is predicted, s.
        left_out: times that were cut out of the others, where gross errors follow one another; disturbed: the same of
            `confirm`.
    """

    known: Problem
    fit: Problem
    choose: Problem
    confirm: Problem
    window_s: float
    horizon_s: float
    left_out: tuple[Span, ...] = ()
    disturbed: tuple[Span, ...] = ()

    @property
    def every(self) -> Problem:
        """The windows of all folds."""
        return self.known.on(Windows.of([*self.known.windows, *self.confirm.windows]))

    def past_the_unknown(self, reach_s: float) -> Parts:
        """The same without the samples on which commands from before the record may still act."""
        kept = self.changed(lambda p: p.past_the_unknown(reach_s))
        known_from = self.known.t[self.known.firsts] + reach_s
        return replace(kept, left_out=tuple(s for s in self.left_out if s[2] > known_from[s[0]]))

    def with_gross_errors(self, usual: Floats, spans: tuple[Span, ...]) -> Parts:
        """The same where misses much larger than a usual one (k,) are gross errors that weigh nothing.

        Fitted windows are cut where such errors were seen to begin and to end: each part has an initial state.
        """
        parts = self.changed(lambda p: replace(p, usual=usual))
        return replace(parts.changed(lambda p: p.on(cut_at(p.windows, p.t, spans))), confirm=parts.confirm)

    def leaving_out(self, spans: tuple[Span, ...]) -> Parts:
        """The same without those times in what is fitted and in what chooses; what confirms is kept whole."""
        parts = self.changed(lambda p: p.on(left_out(p.windows, p.t, spans)))
        return replace(parts, confirm=self.confirm, left_out=spans)

    def confirmed_without(self, spans: tuple[Span, ...]) -> Parts:
        """The same without those times in what confirms."""
        confirm = self.confirm.on(left_out(self.confirm.windows, self.confirm.t, spans))
        return replace(self, confirm=confirm, disturbed=spans)

    def with_tier(self, settings: DiagnosisSettings, second: bool, last: bool) -> Parts:
        """The same windows and law of the noise with other candidates: see `parts_of`."""
        own = self.known.model
        compiled = _compiled(own.model, own.measured, settings, second, last)
        return self.changed(lambda p: replace(p, model=compiled, memo=Memo()))

    def changed(self, change: Callable[[Problem], Problem]) -> Parts:
        """Each of the problems, changed."""
        known, fit, choose, confirm = (change(p) for p in (self.known, self.fit, self.choose, self.confirm))
        return replace(self, known=known, fit=fit, choose=choose, confirm=confirm)


_SHORT = (
    "The record is short: windows of {:.3g} s instead of {:g} s, so that fit, choose and confirm have some each; "
    "a longer one says more."
)
_RUNS_AWAY = (
    "Windows of {:.3g} s instead of {:g} s: in a longer one the model multiplies an error of its start by more than "
    "{:.0f}, so that no start can be fitted."
)
_NO_COORDINATES = (
    "The equations declare no coordinates (plant.symbolic.coordinates): friction, springs and other forces on the "
    "motion are not sought. Where a speed alone is modelled, add its position as a state; it need not be measured."
)
_OF_MOTION = {"m", "m/s", "rad", "rad/s"}

_NO_PLACE = "{} was named and not sought: it has no place in this model, as it needs {}."


def _compiled(
    model: SymbolicModel, measured: tuple[str, ...], settings: DiagnosisSettings, second: bool = False,
    last: bool = False,
) -> SuperModel:  # fmt: skip
    """The model with its candidates: those of the first tier, or those that the settings name.

    `second`: with effects that others are tried before; `last`: with those that are sought after all others; but for
    these, the ones that the settings name beside others are left out until then.
    """
    early = tuple(n for n in settings.effects if not effect(n).last)
    return cached_supermodel(model, measured, settings.effects if last or not early else early, second, last)


def parts_of(model: SymbolicModel, record: Record, settings: DiagnosisSettings) -> tuple[Parts, tuple[str, ...]]:
    """The folds as problems with the first tier of effects, and what is to be said of them."""
    compiled = _compiled(model, record.measured, settings)
    readings = worth(record, settings.noise)
    windows, folds, length = cut_in_folds(record, settings, settings.window_s)
    said = (_SHORT.format(length, settings.window_s),) if length < settings.window_s else ()
    cut = length
    every = build_problem(compiled, record, windows, readings.sigma, readings.weight)
    while runs_away(every) and windows.samples > 4 * MIN_SAMPLES * len(windows):
        windows, folds, length = cut_in_folds(record, settings, length / 2)
        every = every.on(windows)
    said = (*said, _RUNS_AWAY.format(length, cut, GROWTH**2)) if length < cut else said
    every = settled(every)
    moves = any(model.units[name] in _OF_MOTION for name in model.state_names)
    if moves and model.wheels is None and not model.coordinates:
        said = (*said, _NO_COORDINATES)
    named = map(effect, settings.effects)
    said = (*said, *(_NO_PLACE.format(e.name, e.needs) for e in named if not e.targets(model)))
    known = folds.fit | folds.choose
    fit, choose, confirm = (every.on(windows.pick(mask)) for mask in (folds.fit, folds.choose, folds.confirm))
    horizon_s = min(settings.horizon_s, length if length < cut else math.inf)  # what runs away is not foreseen further
    parts = Parts(every.on(windows.pick(known)), fit, choose, confirm, length, horizon_s)
    return parts.past_the_unknown(every.reach(compiled.null)), said  # reach of delays that the model declares
