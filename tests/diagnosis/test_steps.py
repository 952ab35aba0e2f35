"""The steps from the model as declared to the answer."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import begun
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.verdict.answer import steps
from tests.diagnosis.plants import block
from tests.diagnosis.test_watch import EFFECTS, _record, stop_at


@pytest.mark.parametrize(("most", "extra"), [(10**9, 0.2), (1, 0.02)])
def test_steps_lead_from_the_declared_model_to_the_answer(monkeypatch, most, extra):
    stop_at(monkeypatch, most)
    d = diagnose(block(), _record(extra=extra), DiagnosisSettings(effects=EFFECTS))
    taken = [o for s in d.steps for o in s.options if o.taken]
    assert {(o.name, o.on) for o in taken if o.name not in ("late_log",)} == {(e.name, e.on) for e in d.effects}
    assert d.steps[0].chi2_dof == pytest.approx(d.before.chi2_dof, rel=0.01)
    for step, after in itertools.pairwise(d.steps):
        assert [o.taken for o in step.options] == [True] + [False] * (len(step.options) - 1)
        assert after.chi2_dof == step.options[0].chi2_dof
    assert taken[-1].chi2_dof == pytest.approx(d.after.chi2_dof, rel=0.01)
    alone = {(c.name, c.on): c.bic_gain for c in d.candidates if c.bic_gain is not None}
    assert {(o.name, o.on): o.bic_gain for o in d.steps[0].options}.items() <= alone.items()
    if most > 1:
        assert len(d.steps[0].options) > 1  # others were fitted beside what was taken
        assert not any(o.taken for o in d.steps[-1].options)


def test_steps_to_an_answer_from_other_windows_begin_in_their_own_states():
    """What was fitted to every window led back into a search over some of them, which ended in a traceback."""
    parts, _ = parts_of(block(), _record(extra=0.2), DiagnosisSettings(effects=EFFECTS))
    few = parts.known.on(parts.known.windows.pick(np.arange(0, len(parts.known.windows), 3)))
    (search, base), (full, every) = (begun(problem, (), Watch(None)) for problem in (few, parts.known))
    members = tuple(few.model.find(*key) for key in (("viscous_friction", "slide"), ("spring", "slide")))
    start = with_values(few.model.null, {c.slots[0]: 0.3 for c in members})
    answer = full.explain(members, start, every)
    assert len(answer.fit.x0) > len(base.x0)
    told = steps(search, search.empty(base), answer)
    assert {(o.name, o.on) for s in told for o in s.options if o.taken} == {c.key for c in members}
    alone = search.explain(members, start, base)
    assert told[-1].options[0].chi2_dof == pytest.approx(alone.fit.chi2 / (few.size - few.taken - 2), rel=1e-3)
