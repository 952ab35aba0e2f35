"""From a model and a record to the problems of the three folds."""

from __future__ import annotations

from simgap.diagnosis.record.folds import cut_in_folds, needed_ahead
from simgap.diagnosis.record.noise import worth
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.effects import EFFECTS
from simgap.model.symbolic import SymbolicModel

_SHORT = (
    "The record is short: windows of {:.3g} s instead of {:g} s, so that fit, choose and confirm have some each; "
    "a longer one says more."
)
_NO_COORDINATES = (
    "The equations declare no coordinates: friction, springs and other forces on the motion are not sought. Name the "
    "degrees of freedom under plant.symbolic.coordinates, and their mass_matrix where one moves another."
)


def parts_of(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, second: bool = False, last: bool = False
) -> tuple[Parts, tuple[str, ...]]:
    """The folds as problems, and what is to be said of them.

    `second`: with effects that others are tried before; `last`: with those that are sought after all others; but for
    these, the ones that the settings name beside others are left out until then.
    """
    early = tuple(n for n in settings.effects if n not in EFFECTS or not EFFECTS[n].last)
    asked = settings.effects if last or not early else early
    compiled = cached_supermodel(model, record.measured, asked, second, last)
    readings = worth(record)
    sigma = readings.sigma
    for name, value in settings.noise.items():
        if name in record.measured:
            sigma[record.measured.index(name)] = value
    ahead = needed_ahead(record, settings.window_s, settings.horizon_s)
    traces, share = settings.held_out_traces, settings.held_out_share
    windows, folds, length = cut_in_folds(record, settings.window_s, traces, share, ahead)
    said = (_SHORT.format(length, settings.window_s),) if length < settings.window_s else ()
    if model.wheels is None and not model.coordinates:
        said = (*said, _NO_COORDINATES)
    every = settled(build_problem(compiled, record, windows, sigma, readings.weight))
    known = folds.fit | folds.choose
    fit, choose, confirm = (every.on(windows.pick(mask)) for mask in (folds.fit, folds.choose, folds.confirm))
    parts = Parts(every.on(windows.pick(known)), fit, choose, confirm)
    return parts.past_the_unknown(every.reach(compiled.null)), said  # reach of delays that the model declares
