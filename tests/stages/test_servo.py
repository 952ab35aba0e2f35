"""A real servo under its own position loop: what is left after four effects, and recordings that nothing has read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simgap.correction.remainder import bound_remainder
from simgap.correction.transitions import held, seen, transitions, within
from simgap.diagnosis.record.conditions import conditioned, under_conditions
from simgap.diagnosis.result import DiagnosisSettings, WindowPrediction
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import choose_steps, with_values
from simgap.effects import AppliedEffect
from simgap.io.recordings.measured import load_reading
from simgap.plants.context import Context

CASE = Path(__file__).parents[2] / "configs/cases/go1_servo.yaml"
SEALED = ("sin_sin_2kg.csv", "up_and_down_2kg.csv")
STARTS = {"viscous_friction": ("b", 0.02), "coulomb_friction": ("F_c", 0.1), "spring": ("k", 0.05),
          "reflected_inertia": ("I", 0.005)}  # fmt: skip


def windows(record, held_out, states):
    """Whole traces, without what a model says of them."""
    for trace in record.traces:
        unknown = np.zeros((len(trace.t), states))
        yield WindowPrediction(
            trace.name,
            trace.name in held_out,
            trace.t,
            trace.y,
            trace.y,
            trace.y,
            unknown,
            trace.u,
            np.ones_like(trace.y),
        )


@pytest.fixture(scope="module")
def context():
    context = Context.load(CASE)
    if not (CASE.parent / context.case.measured.files[0]).is_file():
        pytest.skip("the measured records are not beside the project")
    return context


def corrected_by_fit(context, record, names, reading):
    """The four effects with their numbers, fitted to what is not held out."""
    section, model = context.case.measured, context.plant.corrected
    settings = DiagnosisSettings(
        window_s=section.window_s, effects=tuple(STARTS), held_out_traces=reading.held_out, horizon_s=0.2
    )
    problem = parts_of(conditioned(model, names), record, settings)[0].known
    slots = {name: problem.model.find(name, "hinge").slots[0] for name in STARTS}
    start = with_values(problem.model.null, {slots[n]: size for n, (_, size) in STARTS.items()})
    x0 = initial_states(problem)
    steps = choose_steps(problem, start, x0, slots.values())
    ends = fit(problem, start, x0, list(slots.values()), steps)
    return [AppliedEffect(n, "hinge", {STARTS[n][0]: float(ends.theta[slots[n]])}) for n in STARTS]


def test_what_four_effects_leave_is_narrow_and_covers_recordings_that_nothing_has_read(context):
    section, model, tau = context.case.measured, context.plant.corrected, context.case.domain.tau
    assert not any(name in file for name in SEALED for file in section.files)
    reading = load_reading(model, section, [CASE.parent / f for f in section.files], CASE.parent)
    record, names = under_conditions(reading, model, section.conditions)
    found = corrected_by_fit(context, record, names, reading)
    corrected, shifts = context.plant.corrected_by(found)
    models = conditioned(model, names), conditioned(corrected, names)
    sigma, limits = {"q": 4e-4}, context.case.domain.X
    parts = tuple(windows(record, reading.held_out, 2))
    left = bound_remainder(parts, sigma, models, shifts, tau, section.confidence, limits, {"m": 2.0})
    assert tuple(left.estimated) == ("v",)
    for state in "qv":
        assert left.after[state] <= 0.4 * left.before[state]  # 0.31 of q, 0.34 of v
    quiet = section.model_copy(update={"conditions": (), "masks": (), "held_out": type(section.held_out)()})
    folder = (CASE.parent / section.files[0]).parent
    fresh = load_reading(model, quiet, [folder / name for name in SEALED], CASE.parent).record
    sealed, _ = seen(tuple(windows(fresh, [t.name for t in fresh.traces], 2)), sigma, corrected)
    part = within(transitions(sealed, ["q", "v"], corrected, {}, tau), corrected, limits)
    residual = np.abs(part.then - held(corrected, part))
    bound = np.array([left.after[s] for s in "qv"])
    if left.rest_after is not None:
        rest = np.array([left.rest_after.by[s] for s in "qv"])
        slow = np.abs(part.start[:, 1]) <= left.rest_after.below
        bound = np.where(slow[:, None], rest, bound)
    inside = np.mean(np.all(residual <= bound, axis=1))
    assert inside >= 0.99
